"""Depth from the rendered stereo pair: semi-global matching, and a smooth dense substitute for a learned matcher."""

from __future__ import annotations

import cv2
import numpy as np

_SUBPIXEL = 16.0  # OpenCV's disparities are sixteenths of a pixel
_NEAREST_M = 0.28  # sets the range of disparities
_BLOCK = 5
_BLEED_PX = 2.2
_BIAS_PX = 0.15


def disparity_range(fb: float) -> int:
    """Number of disparities, a multiple of 16; `fb` is focal length times baseline, pixel metres."""
    return max(16, int(np.ceil(fb / _NEAREST_M / 16)) * 16)


def semi_global_matching(left: np.ndarray, right: np.ndarray, fb: float) -> np.ndarray:
    """(H, W) float32 metres from (H, W, 3) uint8 images by OpenCV's StereoSGBM, 0 = no measurement.

    Disparities of 1/16 px, left-right check, uniqueness and speckle filter; `fb` = focal length * baseline.
    """
    disparity = _disparity(left, right, fb, uniqueness=10, check=1, speckle=100)
    return np.where(disparity > 0, fb / np.maximum(disparity, 1e-6), 0).astype(np.float32)


def dense_stereo(left: np.ndarray, right: np.ndarray, fb: float, bias: np.ndarray) -> np.ndarray:
    """(H, W) float32 metres without holes: smooth, bleeding over depth edges, and biased.

    A stand-in for the character of a learned matcher, not for any one: semi-global matching, holes filled from their
    farther side, median, a blur guided by nothing, plus `bias` (H, W) pixels of disparity (see `bias_field`).
    """
    matched = _disparity(left, right, fb, uniqueness=0, check=2, speckle=0)
    if matched.any():
        border = int(np.percentile(matched[matched > 0], 90))
        matched[:, :border] = 0  # what lies there is outside the right image
    disparity = _fill(matched)
    disparity = cv2.medianBlur(disparity, 5)
    smooth = cv2.bilateralFilter(disparity, 9, 1.5, 4.0)
    smooth = cv2.GaussianBlur(smooth, (0, 0), _BLEED_PX) + bias
    return (fb / np.maximum(smooth, fb / 20.0)).astype(np.float32)


def bias_field(height: int, width: int, rng: np.random.Generator) -> np.ndarray:
    """(H, W) float32 a smooth field of disparity errors, pixels, deviation 0.15."""
    coarse = rng.normal(0, 1, (5, 5)).astype(np.float32)
    smooth = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    return smooth * np.float32(_BIAS_PX / max(float(smooth.std()), 1e-6))


def _disparity(left: np.ndarray, right: np.ndarray, fb: float, uniqueness: int, check: int, speckle: int) -> np.ndarray:
    """(H, W) float32 pixels, 0 = none."""
    count = disparity_range(fb)
    matcher = cv2.StereoSGBM.create(
        minDisparity=0, numDisparities=count, blockSize=_BLOCK, P1=8 * 3 * _BLOCK**2, P2=32 * 3 * _BLOCK**2,
        disp12MaxDiff=check, uniquenessRatio=uniqueness, speckleWindowSize=speckle, speckleRange=2, preFilterCap=31,
    )  # fmt: skip
    # OpenCV gives nothing in the first `count` columns; beyond the border it would look at made-up pixels anyway.
    padded = [cv2.copyMakeBorder(x, 0, 0, count, 0, cv2.BORDER_REPLICATE) for x in (left, right)]
    disparity = matcher.compute(*padded)[:, count:].astype(np.float32) / _SUBPIXEL
    visible = np.arange(left.shape[1])[None] - disparity >= 0
    return np.where((disparity > 0) & visible, disparity, 0)


def _fill(disparity: np.ndarray) -> np.ndarray:
    """Fill holes along each row with the smaller of the two disparities beside them (the surface behind)."""
    width = disparity.shape[1]
    known = disparity > 0
    columns = np.arange(width)[None]
    before = np.maximum.accumulate(np.where(known, columns, -1), axis=1)
    after = np.minimum.accumulate(np.where(known, columns, width)[:, ::-1], axis=1)[:, ::-1]
    rows = np.arange(len(disparity))[:, None]
    left = np.where(before >= 0, disparity[rows, np.maximum(before, 0)], np.inf)
    right = np.where(after < width, disparity[rows, np.minimum(after, width - 1)], np.inf)
    filled = np.minimum(left, right)
    floor = float(disparity[known].min()) if known.any() else 1.0
    return np.where(np.isfinite(filled), filled, floor).astype(np.float32)
