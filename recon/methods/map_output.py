"""What a map leaves in its run besides the field: beta maps, curves, what was wrong with the sensors."""

from __future__ import annotations

import json
import shutil
from collections import Counter
from typing import Any

from torch import Tensor

from ..core.events import OnEvent, Warn
from ..core.files import BETA_UNITS_PER_M, encode_metres, explain_write_errors, write_image, write_text
from ..run.directory import RunDirectory
from ..sensors.fault_detection import FaultDetector
from ..sensors.fault_record import fault_sentences, save_faults


class MapOutput:
    """Files of one map in the making; the first that is written takes those of an earlier map away."""

    def __init__(self, run: RunDirectory) -> None:
        self.run = run
        self._alone = False

    def drop_earlier_map(self) -> None:
        """Forget the earlier map and all that was made of it, once."""
        if self._alone:
            return
        self._alone, run = True, self.run
        run.begin_stage("map")
        with explain_write_errors(run.root):
            shutil.rmtree(run.root / "beta", ignore_errors=True)
            for path in (
                run.curves_path,
                run.noise_model_path,
                run.tracking_path,
                run.sensors_path,
                run.method_state_path,
            ):
                path.unlink(missing_ok=True)

    def write_beta(self, index: int, sensor: str, beta: Tensor) -> None:
        """beta (H, W) metres of a reading's sensor."""
        self.drop_earlier_map()
        write_image(self.run.beta_path(sensor, index), encode_metres(beta.numpy(), BETA_UNITS_PER_M))

    def write_curves(self, losses: dict[str, list[float]]) -> None:
        """Likelihoods over time, by name, nats."""
        axes = {"x_label": "step", "y_label": "negative log-likelihood (nats)"}
        curves = {name: {"x": list(range(len(y))), "y": y, **axes} for name, y in losses.items() if y}
        write_text(self.run.curves_path, json.dumps(curves))

    def write_faults(self, health: FaultDetector, on_event: OnEvent) -> dict[str, Any]:
        """Write what was wrong with the sensors, and say it; facts: by sensor and reason, frames that were left out."""
        save_faults(self.run.sensors_path, health.verdicts)
        faulty: dict[str, Any] = {}
        for sensor, verdicts in health.verdicts.items():
            for sentence in fault_sentences(sensor, verdicts):
                on_event(Warn(sentence))
            counts = Counter(verdict for verdict in verdicts.values() if verdict != "ok")
            faulty |= {sensor: dict(counts)} if counts else {}
        return {"faulty_frames": faulty} if faulty else {}
