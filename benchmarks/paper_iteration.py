"""Seconds of one iteration of `uncle-paper`: as it runs here, beside plain PyTorch; see benchmarks/README.md."""

from __future__ import annotations

import argparse
import json
import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from uncle.recon.core.config.map_config import make_config
from uncle.recon.core.device import choose_device
from uncle.recon.core.tensor_files import load_tensors
from uncle.recon.evaluation.bench.tables import markdown_table
from uncle.recon.methods.nice.mapper import StageOptimizer
from uncle.recon.methods.nice.poses import to_pose_matrix, to_pose_vector
from uncle.recon.methods.nice.scene import Stage
from uncle.recon.methods.nice.system import NiceSystem
from uncle.recon.methods.nice.views import Window
from uncle.recon.run.directory import RunDirectory
from uncle.recon.run.frames import RunFrames

STAGES: tuple[Stage, ...] = ("middle", "fine", "color")


class Bench:
    """A scene that the first frame of a run was mapped into, and a window of five of its frames."""

    def __init__(self, run: Path, sensors: list[str], rays: int, warm: int, device: str) -> None:
        self.device = choose_device(device)
        settings = [f"nice_mapping.first_iterations={warm}", f"nice_mapping.iterations={max(1, warm // 10)}",
                    f"nice_mapping.pixels={rays}"]  # fmt: skip
        config = make_config("uncle-paper", [*settings, f"nice_tracking.pixels={rays}"], sensors=tuple(sensors))
        self.frames = RunFrames(RunDirectory(run), sensors)
        self.system = NiceSystem(self.frames, config, self.device)
        indices = [i for i in range(len(self.frames)) if self.frames.pose(i) is not None]
        self.system.begin(indices, lambda event: None)
        chosen = [indices[i] for i in np.linspace(0, min(len(indices) - 1, 100), 5).astype(int)]
        self.views = [self.system.prepare(self.frames[i]).to(self.device) for i in chosen]
        self.poses = np.array([self.frames.pose(i) for i in chosen])
        if warm > 1:
            for view, pose in zip(self.views, self.poses, strict=True):
                self.system.mapper.map(view, pose, last=False)

    def load(self, mapped: Path) -> None:
        """Take scene and networks from a run that `uncle-paper` mapped from the same frames."""
        learned = load_tensors(RunDirectory(mapped).method_state_path)
        self.system.scene.load_state(learned["scene"])
        for name, net in self.system.weighting.networks().items():
            net.load_state_dict(learned["noise"][name])

    def mapping(self, stage: Stage) -> Callable[[], None]:
        """One iteration of the mapper over the window."""
        mapper, scene = self.system.mapper, self.system.scene
        window = Window(self.views, self.frames.camera, mapper.weighting.patch_size, mapper.weighting.color_patch)
        poses = to_pose_matrix(to_pose_vector(self.poses)).to(self.device)
        scene.unfreeze()
        settings = self.system.config.nice_mapping.model_copy(update={"learning_rate_middle": 1e-5,
                                                                     "learning_rate": 1e-5})  # fmt: skip
        optimizer = StageOptimizer(scene, mapper.weighting, None, settings, 1.0, "color")
        return lambda: optimizer.step(mapper.loss(window, poses, stage), stage, {})

    def tracking(self) -> Callable[[], None]:
        """One iteration of the tracker on the last frame of the window."""
        tracker = self.system.opened.tracker
        tracker.scene.freeze()
        window = Window([self.views[-1]], self.frames.camera, tracker.weighting.patch_size,
                        tracker.weighting.color_patch, tracker.settings.edge)  # fmt: skip
        seven = to_pose_vector(self.poses[-1:]).to(self.device).requires_grad_()
        adam = torch.optim.Adam([seven], 1e-6, fused=True)

        def step() -> None:
            adam.zero_grad(set_to_none=True)
            tracker.loss(window, to_pose_matrix(seven)).backward()
            adam.step()

        return step

    def seconds(self, step: Callable[[], None], plain: bool) -> tuple[float, float]:
        """Wall and processor seconds of one step, `plain` or as it runs."""
        usual = self.system.opened.evaluate
        opened = self.system.opened
        opened.mapper.evaluate = opened.tracker.evaluate = opened.scene.values if plain else usual
        began, cpu = time.perf_counter(), time.process_time()
        step()
        if self.device.type == "cuda":
            torch.cuda.synchronize()
        return time.perf_counter() - began, time.process_time() - cpu


def measure(bench: Bench, times: int) -> list[dict[str, float | str]]:
    """Both ways in turns, medians, after one round that does not count."""
    rows: list[dict[str, float | str]] = []
    jobs = [
        *((f"mapping, {stage}", lambda s=stage: bench.mapping(s)) for stage in STAGES),
        ("tracking", bench.tracking),
    ]
    for name, prepare in jobs:
        step = prepare()
        found: dict[bool, list[tuple[float, float]]] = {False: [], True: []}
        for repeat in range(times + 1):
            for plain in (False, True):
                spent = bench.seconds(step, plain)
                if repeat:
                    found[plain].append(spent)
        wall = {plain: statistics.median(s[0] for s in spent) for plain, spent in found.items()}
        cpu = {plain: statistics.median(s[1] for s in spent) for plain, spent in found.items()}
        seconds = {"seconds": wall[False], "plain_seconds": wall[True], "ratio": wall[True] / wall[False]}
        rows.append({"iteration": name, **seconds, "cpu_seconds": cpu[False], "plain_cpu_seconds": cpu[True]})
    return rows


def main() -> None:
    """Print the table, and JSON with --json."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path, help="a preprocessed run with poses")
    parser.add_argument("--sensors", nargs="+", default=["sl"])
    parser.add_argument("--rays", type=int, default=5000)
    parser.add_argument("--warm", type=int, default=100, help="iterations on the first frame; 1: an untouched scene")
    parser.add_argument("--scene", type=Path, help="a run mapped with uncle-paper, whose scene is taken instead")
    parser.add_argument("--times", type=int, default=7)
    parser.add_argument("--device", choices=["auto", "cpu", "cuda"], default="cpu")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    warm = 1 if arguments.scene else arguments.warm
    bench = Bench(arguments.run, arguments.sensors, arguments.rays, warm, arguments.device)
    if arguments.scene:
        bench.load(arguments.scene)
    rows = measure(bench, arguments.times)
    if arguments.json:
        facts = {"threads": torch.get_num_threads(), "cores": os.cpu_count(), "device": str(bench.device)}
        print(json.dumps({**facts, "rays": arguments.rays, "warm": warm, "scene": str(arguments.scene), "rows": rows}))
        return
    head = ["iteration", "s", "plain PyTorch s", "times quicker", "CPU s", "plain CPU s"]
    keys = ("seconds", "plain_seconds", "ratio", "cpu_seconds", "plain_cpu_seconds")
    print(
        *markdown_table(head, [[str(row["iteration"]), *(f"{row[key]:.3f}" for key in keys)] for row in rows]), sep="\n"
    )


if __name__ == "__main__":
    main()
