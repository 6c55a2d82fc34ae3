"""The training of the decoders as a whole: progress, interruptions, the file with its recipe and scores."""

from __future__ import annotations

import hashlib
import json
import platform
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from ...core.errors import ConfigError
from ...core.events import Note, OnEvent, Progress, ignore
from ...run.checkpoint import Checkpoint
from ..nice.decoder_files import save_decoders
from ..nice.decoders import OccupancyDecoders
from .decoder_scores import decoder_scores
from .decoder_training import DecoderTrainer, DecoderTraining

REPORT_EVERY = 20  # steps


def pretrain_decoders(
    out: Path, settings: DecoderTraining, device: torch.device, *, overwrite: bool = False, on_event: OnEvent = ignore
) -> OccupancyDecoders:
    """Train, score on unseen rooms, and write `out`; the unfinished training is kept beside it and continued.

    Raises ConfigError if `out` exists or the settings do not fit together, and RunError if it cannot be written.
    """
    _check(settings)
    if out.exists() and not overwrite:
        raise ConfigError(f"{out} exists; choose another --out, or --overwrite to replace it")
    digest = hashlib.sha256(json.dumps(asdict(settings), sort_keys=True).encode()).hexdigest()
    checkpoint = Checkpoint(out.with_name(out.name + ".unfinished"), digest)
    began = time.monotonic()
    trainer, continued = DecoderTrainer(settings, device), []
    state = checkpoint.load()
    if state is not None:
        trainer.restore(state)
        continued = [*state["continued"], trainer.done]
        on_event(Note(f"goes on at step {trainer.done}"))
    _train(trainer, checkpoint, continued, on_event)
    scores = decoder_scores(trainer.decoders, device)
    trainer.decoders.recipe.update(_recipe(settings, device, continued, time.monotonic() - began, scores))
    save_decoders(out, trainer.decoders)
    checkpoint.remove()
    middle, fine = (f"{100 * scores[f'{name}_iou']:.1f} %" for name in ("middle", "fine"))
    on_event(Note(
        f"{out}: IoU in rooms never seen {middle} (middle), {fine} (with fine); features near zero have logit "
        f"{scores['fresh_logit']:.2f}"
    ))  # fmt: skip
    return trainer.decoders


def _train(trainer: DecoderTrainer, checkpoint: Checkpoint, continued: list[int], on_event: OnEvent) -> None:
    steps = trainer.settings.steps
    on_event(Progress("decoders", trainer.done, steps, "steps"))
    while trainer.done < steps:
        trainer.step()
        if trainer.done % REPORT_EVERY == 0 or trainer.done == steps:
            on_event(Progress("decoders", trainer.done, steps, "steps"))
            if checkpoint.due() and trainer.done < steps:
                checkpoint.save({**trainer.state(), "continued": continued})


def _check(settings: DecoderTraining) -> None:
    if settings.cubes % settings.groups:
        raise ConfigError(f"--cubes {settings.cubes} is not a multiple of {settings.groups}, the groups of cubes")


def _recipe(
    settings: DecoderTraining, device: torch.device, continued: list[int], seconds: float, scores: dict[str, float]
) -> dict[str, Any]:
    """What has to be known to repeat the training and to compare it with others."""
    machine = torch.cuda.get_device_name(device) if device.type == "cuda" else platform.machine()
    versions = {"torch": str(torch.__version__), "python": platform.python_version()}
    return {
        "settings": asdict(settings), "versions": versions, "device": f"{device.type}, {machine}", "scores": scores,
        "seconds": round(seconds, 1), "continued_at_steps": continued,
    }  # fmt: skip
