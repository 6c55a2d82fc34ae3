"""How much later one stream of a recording is stamped than another that shows the same motion.

Colour and depth of a Kinect come with time stamps of their own, taken when an image has arrived and not when it was
exposed. Both streams see the camera turn: the shift of the picture from one image to the next, as a signal over time,
is nearly the same in both, and one signal fits the other best at the true delay. No pose is needed.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from scipy.stats import rankdata

from ..recon.core.depth_image import read_depth_values
from ..recon.core.errors import DataError
from ..recon.core.files import read_image

STRETCHES, STRETCH = 6, 45  # parts of the recording that are looked at, and images in each
LARGEST_S, STEP_S = 0.06, 0.001  # delays that are tried: two images of a Kinect
LONGEST_S = 0.07  # between two images: in more time a picture moves far, and depth images are too few to choose from
_WIDTH_PX = 160  # of the pictures that are compared
_BLOCK = 10  # successive motions that count as one: a hand keeps its speed for a third of a second
_LEAST_BLOCKS = 4
_LEAST_GAIN = 4.0  # sigmas by which signals must fit better than without a delay,
_LEAST_SHARE = 0.15  # and by which share of the error
_LARGEST_ERROR = 0.15  # of ranks; those of unrelated signals differ by a third

Read = Callable[[Path], np.ndarray | None]  # a picture (h, w) float32 of about _WIDTH_PX; None: unreadable


class Stream(NamedTuple):
    """times (N,) seconds, increasing, and the N files taken then."""

    times: np.ndarray
    files: Sequence[Path]


class Motion(NamedTuple):
    """velocities (M, 2) pixels per second of the picture, at times (M,)."""

    times: np.ndarray
    velocities: np.ndarray


def depth_delay(color: Stream, depth: Stream) -> float:
    """Seconds by which depth is stamped later than colour; 0 where the recording does not show any.

    Only delays of whole milliseconds up to `LARGEST_S` are found, and only where the streams then agree much better.
    """
    if min(len(stream.times) for stream in (color, depth)) < STRETCH:
        return 0.0
    firsts = np.linspace(0, len(depth.times) - STRETCH, min(STRETCHES, len(depth.times) // STRETCH)).astype(int)
    starts = depth.times[firsts]
    pairs = [(motion(color, start, color_picture), motion(depth, start, depth_picture)) for start in starts]
    return best_delay([pair for pair in pairs if min(len(stream.times) for stream in pair) > 1])


def best_delay(pairs: Sequence[tuple[Motion, Motion]]) -> float:
    """The delay of the second motion of each pair, by which the first fits it best; 0 where none is clear.

    Ranks are compared, over all pairs: a few wrong motions, or a picture that moves half as much, change little.
    """
    delays = np.arange(-LARGEST_S, LARGEST_S + STEP_S / 2, STEP_S)
    times = [_inside(first, second) for first, second in pairs]
    blocks = sum(len(inside) // _BLOCK for inside in times)
    if blocks < _LEAST_BLOCKS:
        return 0.0
    wanted = _ranks([_smooth(second, inside) for (_, second), inside in zip(pairs, times, strict=True)])
    errors = [np.abs(_ranks(_delayed(pairs, times, delay)) - wanted).mean(axis=1) for delay in delays]
    best, none = int(np.argmin([error.mean() for error in errors])), len(delays) // 2
    gain = np.array([part.mean() for part in np.array_split(errors[none] - errors[best], blocks)])
    clear = gain.mean() > max(_LEAST_GAIN * gain.std() / np.sqrt(blocks), _LEAST_SHARE * errors[none].mean())
    fits = errors[best].mean() < _LARGEST_ERROR and 0 < best < len(delays) - 1
    return round(float(delays[best]), 3) if clear and fits else 0.0


def motion(stream: Stream, start: float, read: Read) -> Motion:
    """Of the picture over some images from `start` seconds on; images that cannot be read are passed over."""
    first = int(np.searchsorted(stream.times, start))
    chosen = range(first, min(first + STRETCH, len(stream.times)))
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        pictures = list(pool.map(read, [stream.files[n] for n in chosen]))
    seen = [(stream.times[n], picture) for n, picture in zip(chosen, pictures, strict=True) if picture is not None]
    times, velocities = [], []
    for (before, earlier), (now, later) in pairwise(seen):
        if earlier.shape != later.shape or now - before > LONGEST_S:
            continue
        window = cv2.createHanningWindow(later.shape[::-1], cv2.CV_32F)
        shift, _ = cv2.phaseCorrelate(earlier, later, window)
        times.append((before + now) / 2)
        velocities.append(np.array(shift) / (now - before))
    return Motion(np.array(times), np.array(velocities).reshape(-1, 2))


def color_picture(file: Path) -> np.ndarray | None:
    """Grey values."""
    image = _read(lambda path: read_image(path, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION), file)
    return None if image is None else _small(image.astype(np.float32))


def depth_picture(file: Path) -> np.ndarray | None:
    """Nearness, which shows edges as colour does; holes are as near as the median."""
    image = _read(read_depth_values, file)
    if image is None or not image.any():
        return None
    read = image > 0
    known = _small(read.astype(np.float32))
    near = _small(np.where(read, 1 / np.where(read, image, 1).astype(np.float32), 0)) / np.maximum(known, 1e-6)
    near = np.where(known > 0, near, np.median(near[known > 0]))
    return (near / near.max()).astype(np.float32)


def _read(read: Callable[[Path], np.ndarray], file: Path) -> np.ndarray | None:
    """An image of one channel and of some size, or None; that it is broken is reported when the frame is read."""
    try:
        image = read(file)
    except (DataError, cv2.error):
        return None
    return image if image.ndim == 2 and min(image.shape) > 16 else None


def _small(image: np.ndarray) -> np.ndarray:
    factor = max(1, image.shape[1] // _WIDTH_PX)
    size = (image.shape[1] // factor, image.shape[0] // factor)
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)


def _inside(first: Motion, second: Motion) -> np.ndarray:
    """The times of `second` that `first` covers at every delay."""
    margin = LARGEST_S + LONGEST_S / 2
    return second.times[(second.times > first.times[0] + margin) & (second.times < first.times[-1] - margin)]


def _smooth(motion: Motion, times: np.ndarray) -> np.ndarray:
    """(M, 2) velocities at `times` (M,), means over one period.

    Interpolated alone they would be smoother between two measurements than at one, and fit better for that.
    """
    half = np.median(np.diff(motion.times)) / 2
    around = [times + shift for shift in (-half, 0.0, half)]
    return np.stack([np.mean([np.interp(t, motion.times, v) for t in around], axis=0) for v in motion.velocities.T], 1)


def _delayed(pairs: Sequence[tuple[Motion, Motion]], times: Sequence[np.ndarray], delay: float) -> list[np.ndarray]:
    """(M, 2) of each pair: velocities of the first `delay` before `times` (M,)."""
    return [_smooth(first, inside - delay) for (first, _), inside in zip(pairs, times, strict=True)]


def _ranks(velocities: Sequence[np.ndarray]) -> np.ndarray:
    """(M, 2) ranks, 0 to 1, of each axis by itself."""
    together = np.concatenate(velocities)
    return rankdata(together, axis=0) / len(together)
