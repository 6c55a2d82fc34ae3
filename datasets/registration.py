"""Colour of one camera as another camera, the one that measured depth, would have seen it."""

from __future__ import annotations

import cv2
import numpy as np

from ..recon.core.camera import Camera

TYPICAL_DEPTH_M = 2.0  # where a frame has no measurement at all: rooms are seen from about there
MEDIAN_PX = 5  # measurements flicker at edges; without a median the colour would be torn there
FINER = 1.5  # colour that has this many times the pixels per angle is shrunk first, or it would alias


class ColorRegistration:
    """Resamples colour images to the pixels of the depth camera. One object may serve several threads.

    `color_camera` took the colour images, free of lens distortion, and `depth_camera` the depth images;
    `T_color_depth` (4, 4) takes points in metres from the axes of the depth camera to those of the colour camera.
    """

    def __init__(self, color_camera: Camera, T_color_depth: np.ndarray, depth_camera: Camera) -> None:
        self._size = (color_camera.width, color_camera.height)
        finer = color_camera.fx / depth_camera.fx
        if finer > FINER:
            color_camera = color_camera.resized(*(max(1, round(length / finer)) for length in self._size))
        self._camera = color_camera
        # Divided by depth z, the projection of pixel (u, v) is K_color (R ray + t / z): linear in inverse depth.
        to_pixels = color_camera.matrix @ T_color_depth[:3]
        v, u = np.mgrid[: depth_camera.height, : depth_camera.width].astype(np.float64)
        rays = np.stack([(u - depth_camera.cx) / depth_camera.fx, (v - depth_camera.cy) / depth_camera.fy, u * 0 + 1])
        self._far = np.tensordot(to_pixels[:, :3], rays, 1).astype(np.float32)  # (3, H, W): the pixels at infinity
        self._parallax = to_pixels[:, 3].astype(np.float32)

    def __call__(self, color: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """(H, W, 3) uint8 at the pixels of the depth image, from the colour camera's image (Hc, Wc, 3) uint8.

        `depth` (H, W) float32 is z-depth in metres, 0 = no measurement; such pixels are taken to lie on the
        background beside them. Pixels outside the colour image repeat its border.
        """
        if (self._camera.width, self._camera.height) != self._size:
            color = cv2.resize(color, (self._camera.width, self._camera.height), interpolation=cv2.INTER_AREA)
        closeness = cv2.medianBlur(filled_inverse_depth(depth), MEDIAN_PX)
        x, y, w = (far + shift * closeness for far, shift in zip(self._far, self._parallax, strict=True))
        np.maximum(w, np.float32(1e-6), out=w)
        # Cubic: images are enlarged a little here, and linear interpolation would cost a fifth of their features.
        return cv2.remap(color, x / w, y / w, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)


def filled_inverse_depth(depth: np.ndarray) -> np.ndarray:
    """(H, W) float32 1/m of z-depth in metres (0 = no measurement); holes take the farther of their row's neighbours.

    Most holes of depth sensors are shadows: background that the projector or the second camera does not see, beside
    what hides it. A row without a measurement takes the mean of the image, an image without any a typical depth.
    """
    known = depth > 0
    if not known.any():
        return np.full(depth.shape, np.float32(1 / TYPICAL_DEPTH_M))
    with np.errstate(divide="ignore"):
        inverse = np.float32(1) / depth
    holes, readings = np.flatnonzero(~known), np.flatnonzero(known)
    after = np.searchsorted(readings, holes)
    neighbours = readings[np.clip([after - 1, after], 0, len(readings) - 1)]  # (2, number of holes)
    same_row = neighbours // depth.shape[1] == holes // depth.shape[1]
    farther = np.where(same_row, inverse.flat[neighbours], np.inf).min(axis=0)
    inverse.flat[holes] = np.where(np.isinf(farther), inverse[known].mean(), farther)
    return inverse
