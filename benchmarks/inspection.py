"""How often `uncle inspect` names an error that was put into a good recording; see README.md.

Each corruption is made in memory: what the inspection reads is what a recording with that error would give.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from uncle.datasets.registry import open_dataset
from uncle.recon.core.correction import CorrectedRecording, Correction
from uncle.recon.core.errors import UncleError
from uncle.recon.core.frame import Recording
from uncle.recon.evaluation.inspection.correspondences import FrameInterval, InspectedFrames
from uncle.recon.evaluation.inspection.inspector import QUICK, THOROUGH, Inspection, inspect_recording
from uncle.recon.stages.inspect import MAX_DEPTH_M

LAG_S = 0.05
USUAL_FRAME_S = 1 / 30  # of recordings without a clock
OTHER_CALIBRATION = (1.12, 6.0, -4.0)  # colour: scale about the centre, then pixels right and down


class AlongRay(CorrectedRecording):
    """Depth as a distance from the camera centre."""

    def depth(self, index: int, sensor: str) -> torch.Tensor:
        return self.recording.depth(index, sensor) * self.camera.rays().norm(dim=-1)


class OtherColorCalibration(CorrectedRecording):
    """Colour as another camera would take it, not registered to depth."""

    def color(self, index: int) -> torch.Tensor:
        image = self.recording.color(index).numpy()
        height, width = image.shape[:2]
        scale, right, down = OTHER_CALIBRATION
        shift = (width / 2 * (1 - scale) + right, height / 2 * (1 - scale) + down)
        matrix = np.array([[scale, 0.0, shift[0]], [0.0, scale, shift[1]]])
        return torch.from_numpy(cv2.warpAffine(image, matrix, (width, height)))


class ExchangedSensors(CorrectedRecording):
    """The depth of each sensor under the name of another one."""

    def depth(self, index: int, sensor: str) -> torch.Tensor:
        position = self.sensors.index(sensor)
        return self.recording.depth(index, self.sensors[(position + 1) % len(self.sensors)])


@dataclass(frozen=True)
class Corruption:
    """An error that is put in, and the check that names it."""

    name: str
    check: str
    make: Callable[[Recording], Recording | None]


def _plain(correction: Correction) -> Callable[[Recording], Recording]:
    return lambda recording: CorrectedRecording(recording, correction)


def _other_size(recording: Recording) -> Recording:
    camera = recording.camera
    return CorrectedRecording(
        recording, Correction(focal_x=2.0, focal_y=2.0, shift_x=camera.cx + 0.5, shift_y=camera.cy + 0.5)
    )


def _lag(recording: Recording) -> Recording:
    steps = np.diff([recording.timestamp(index) for index in range(len(recording))])
    frame_s = float(np.median(steps)) if recording.has_timestamps else USUAL_FRAME_S
    return CorrectedRecording(recording, Correction(lag=LAG_S / frame_s))


def _exchanged(recording: Recording) -> Recording | None:
    return ExchangedSensors(recording, Correction()) if len(recording.sensors) > 1 else None


CORRUPTIONS = (
    Corruption("none", "", lambda recording: recording),
    Corruption("depth x 5", "depth scale", _plain(Correction(depth_factor=5.0))),
    Corruption("depth x 1000", "depth scale", _plain(Correction(depth_factor=1000.0))),
    Corruption("depth / 1000", "depth scale", _plain(Correction(depth_factor=0.001))),
    Corruption("focal x 1.3", "intrinsics", _plain(Correction(focal_x=1.3))),
    Corruption("both focal x 1.3", "intrinsics", _plain(Correction(focal_x=1.3, focal_y=1.3))),
    Corruption("other image size", "intrinsics", _other_size),
    Corruption("poses inverted", "pose convention", _plain(Correction(is_inverted=True))),
    Corruption("poses OpenGL", "pose convention", _plain(Correction(is_opengl=True))),
    Corruption("poses in mm", "pose scale", _plain(Correction(translation_factor=1000.0))),
    Corruption("poses + 1 frame", "pose clock", _plain(Correction(lag=1.0))),
    Corruption("poses + 5 frames", "pose clock", _plain(Correction(lag=5.0))),
    Corruption("poses + 50 ms", "pose clock", _lag),
    Corruption("colour + 8 px", "registration", _plain(Correction(color_x=8.0))),
    Corruption("colour of another calibration", "registration",
               lambda recording: OtherColorCalibration(recording, Correction())),
    Corruption("depth along the ray", "depth along the ray", lambda recording: AlongRay(recording, Correction())),
    Corruption("sensors exchanged", "sensor names", _exchanged),
)  # fmt: skip


def named(inspection: Inspection) -> str:
    """The check of the finding to mend first, "" if all is well."""
    first = inspection.first
    return first.check if first is not None else ""


def is_named(inspection: Inspection, corruption: Corruption) -> bool:
    """Whether the error is the first finding; without one, whether at most one doubt is found."""
    if corruption.check:
        return named(inspection) == corruption.check
    verdicts = [str(one.verdict) for one in inspection.findings]
    return "wrong" not in verdicts and verdicts.count("doubt") <= 1


def trials(
    recording: Recording, only: Sequence[str] | None, slices: int | None
) -> Iterator[tuple[str, Corruption, InspectedFrames]]:
    """Name, error and frames of each trial: parts of the recording as they are, or the whole with each error."""
    if slices:
        for start in range(0, max(len(recording) - slices // 2, 1), slices):
            end = min(start + slices, len(recording))
            yield f"frames {start} to {end - 1}", CORRUPTIONS[0], FrameInterval(recording, start, end)
        return
    for corruption in CORRUPTIONS:
        corrupted = corruption.make(recording) if not only or corruption.name in only else None
        if corrupted is not None:
            yield corruption.name, corruption, corrupted


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("datasets", nargs="+", type=Path, metavar="DATASET")
    parser.add_argument("--only", nargs="+", metavar="CORRUPTION", help="only these corruptions, by name")
    parser.add_argument("--sensors", nargs="+", metavar="NAME", help="only these sensors")
    parser.add_argument("--slices", type=int, metavar="FRAMES", help="each part of so many frames by itself, as it is")
    parser.add_argument("--quick", action="store_true", help="inspect as `uncle preprocess` does")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a line for each data set and corruption, and the share that was named."""
    options = parse(arguments)
    right = total = 0
    print("| data set | corruption | named | verdict | text | s |\n|---|---|---|---|---|---|", flush=True)
    for path in options.datasets:
        recording = open_dataset(path)
        for name, corruption, frames in trials(recording, options.only, options.slices):
            started = time.perf_counter()
            inspection = inspect_recording(
                frames,
                has_timestamps=recording.has_timestamps,
                max_depth_m=MAX_DEPTH_M,
                sensors=options.sensors,
                effort=QUICK if options.quick else THOROUGH,
            )
            first = inspection.first
            found = named(inspection)
            is_right = is_named(inspection, corruption)
            right, total = right + is_right, total + 1
            text = "" if first is None else f"{first.value} {first.unit}: {first.text}"
            verdict = "" if first is None else str(first.verdict)
            mark = "" if is_right else "**not** "
            seconds = time.perf_counter() - started
            print(f"| {path.name} | {name} | {mark}{found} | {verdict} | {text} | {seconds:.0f} |", flush=True)
    print(f"\n{right} of {total} named rightly ({right / max(total, 1):.1%})")
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (UncleError, OSError) as error:
        sys.exit(f"error: {error}")
