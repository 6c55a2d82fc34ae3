"""Findings about single images: repeated frames, blur, exposure, and the clock of the frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ...core.errors import DataError
from .correspondences import InspectedFrames
from .findings import Finding, Verdict

SMALL_PX = 160  # width to which images are reduced
DARK, BRIGHT = 8, 247
MANY = 0.3  # share of images, or of pixels, above which it is a doubt
FROZEN, FEW_IMAGES = 0.8, 8  # share of repeated images of a moving camera that is wrong, among so many at least
BLURRED = 0.35  # of the median sharpness of the recording
MOVING_M = 0.003  # a camera that moves farther between two equal images is not standing still
LONG_GAP_S = 1.0


@dataclass(frozen=True)
class ImageFacts:
    """Of one colour image: mean difference from the image before (grey values; NaN for the first), sharpness, and the
    share of pixels that are black or saturated."""

    index: int
    change: float
    sharpness: float
    clipped: float


def image_facts(frames: InspectedFrames, indices: Sequence[int]) -> list[ImageFacts]:
    """Facts of the images `indices`, each compared with the frame before it; unreadable images are left out."""
    facts = []
    for index in indices:
        try:
            image = _small(frames, index)
            before = _small(frames, index - 1) if index else None
        except DataError:
            continue
        change = float("nan") if before is None else float(np.abs(image - before).mean())
        clipped = float(((image < DARK) | (image > BRIGHT)).mean())
        facts.append(ImageFacts(index, change, float(cv2.Laplacian(image, cv2.CV_32F).std()), clipped))
    return facts


def image_findings(facts: Sequence[ImageFacts]) -> list[Finding]:
    """Blur and exposure."""
    if not facts:
        return [Finding("colour images", Verdict.WRONG, None, "", "none of the images that were tried can be read")]
    return [_blur(facts), _exposure(facts)]


def time_stamps(frames: InspectedFrames, has_timestamps: bool) -> Finding:
    """Rate of the frames, and gaps."""
    if not has_timestamps or len(frames) < 3:
        return Finding("time stamps", Verdict.UNKNOWN, None, "", "the recording has no clock; frames are counted")
    stamps = np.array([frames.timestamp(index) for index in range(len(frames))])
    steps = np.diff(stamps)
    usual = float(np.median(steps))
    gaps = np.flatnonzero(steps > max(LONG_GAP_S, 10 * usual))
    rate = f"{1 / usual:.1f} frames/s"
    if len(gaps):
        where = f"{len(gaps)} gaps, the first of {steps[gaps[0]]:.1f} s after frame {gaps[0]}"
        return Finding("time stamps", Verdict.DOUBT, round(float(steps.max()), 3), "s", f"{rate}, but {where}",
                       "split the recording there with --frames, or give the poses")  # fmt: skip
    return Finding("time stamps", Verdict.OK, round(1 / usual, 2), "frames/s", f"{rate}, no gaps")


def _small(frames: InspectedFrames, index: int) -> np.ndarray:
    image = cv2.cvtColor(frames.color(index).numpy(), cv2.COLOR_RGB2GRAY)
    height = max(1, round(image.shape[0] * SMALL_PX / image.shape[1]))
    reduced: np.ndarray = cv2.resize(image, (SMALL_PX, height), interpolation=cv2.INTER_AREA).astype(np.float32)
    return reduced


def repeated_images(frames: InspectedFrames, facts: Sequence[ImageFacts]) -> Finding:
    """Images that repeat the one before, and whether the poses say that the camera moved in between."""
    repeated = [fact for fact in facts if fact.change == 0.0]
    share = len(repeated) / max(len(facts), 1)
    if not repeated:
        return Finding("repeated images", Verdict.OK, 0.0, "share", "no image repeats the one before")
    moving = [fact for fact in repeated if _moved(frames, fact.index) > MOVING_M]
    text = f"{len(repeated)} of {len(facts)} images repeat the one before, such as frame {repeated[0].index}"
    verdict = Verdict.OK
    if moving:
        text += f"; the poses say that the camera moved in {len(moving)} of them"
        is_frozen = len(moving) > FROZEN * len(facts) and len(facts) >= FEW_IMAGES
        verdict = Verdict.WRONG if is_frozen else Verdict.DOUBT
    elif share > MANY:
        verdict = Verdict.DOUBT
    return Finding("repeated images", verdict, round(share, 3), "share", text, "leave repeated frames out (--frames)")


def _moved(frames: InspectedFrames, index: int) -> float:
    before, pose = frames.pose(index - 1), frames.pose(index)
    return 0.0 if before is None or pose is None else float(np.linalg.norm(pose[:3, 3] - before[:3, 3]))


def _blur(facts: Sequence[ImageFacts]) -> Finding:
    sharpness = np.array([fact.sharpness for fact in facts])
    blurred = sharpness < BLURRED * np.median(sharpness)
    share = float(blurred.mean())
    first = f", such as frame {facts[int(np.argmax(blurred))].index}" if blurred.any() else ""
    verdict = Verdict.DOUBT if share > MANY else Verdict.OK
    text = f"{int(blurred.sum())} of {len(facts)} images are much less sharp than the others{first}"
    return Finding("sharpness", verdict, round(share, 3), "share", text)


def _exposure(facts: Sequence[ImageFacts]) -> Finding:
    clipped = np.array([fact.clipped for fact in facts])
    usual = float(np.median(clipped))
    verdict = Verdict.DOUBT if usual > MANY else Verdict.OK
    text = f"{usual:.0%} of the pixels are black or saturated in a usual image"
    return Finding("exposure", verdict, round(usual, 3), "share", text, "tracking needs images with detail")
