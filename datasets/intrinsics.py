"""Whether the intrinsics of a recording are those of its images, and the ones that are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ..recon.core.camera import Camera
from ..recon.core.errors import DataError
from .calibration import Calibration
from .images import usual_size

SAME_RATIO = 0.03  # width and height ratios that differ by less are one ratio: sizes and principal points are rounded
CLEAR_RATIO = 1.35  # the principal point of a lens is never as far off the middle as that of another image size
DOUBTFUL_RATIO = 1.25  # this far off in one direction is a crop, or a mistake
MIN_FOCAL_RATIO = 0.12  # focal length by image width: a field of view of 153 degrees
MIN_WIDTH_PX = 16


@dataclass(frozen=True)
class FittedCamera:
    """A camera of the size of the images, and what was changed or is doubtful."""

    camera: Camera
    notes: tuple[str, ...] = ()


def fit_calibration(
    calibration: Calibration, depths: Sequence[Path], colors: Sequence[Path]
) -> tuple[Calibration, tuple[str, ...]]:
    """The calibration with cameras of the size of the images, and notes on what was changed.

    `depths` and `colors` are the image files. Raises DataError if the intrinsics cannot be those of the images.
    """
    stated = calibration.camera
    size = usual_size(depths, stated)
    color_size = usual_size(colors, calibration.color_camera or stated)
    if calibration.color_camera is None and not calibration.resize_color and color_size != size:
        raise DataError(
            f"depth images are {size[0]}x{size[1]}, colour images {color_size[0]}x{color_size[1]}: if another camera "
            "took colour, state color_camera and T_color_depth in camera.json, else resize one to the other"
        )
    fitted = fit_camera(stated, size, "depth images" if calibration.color_camera else "images")
    if calibration.color_camera is None:
        return replace(calibration, camera=fitted.camera), fitted.notes
    color = fit_camera(calibration.color_camera, color_size, "colour images")
    return replace(calibration, camera=fitted.camera, color_camera=color.camera), fitted.notes + color.notes


def fit_camera(camera: Camera, size: tuple[int, int], what: str) -> FittedCamera:
    """The camera `camera` of images of another size if that is clear. Raises DataError if it cannot be.

    A principal point lies near the middle of an image, so it tells the size of the image that intrinsics belong to.
    """
    notes = []
    if (camera.width, camera.height) != size:
        if not _same(size[0] / camera.width, size[1] / camera.height):
            raise DataError(
                f"the intrinsics are of {camera.width}x{camera.height}, but the {what} of {size[0]}x{size[1]}, which "
                "is another shape: state the intrinsics of these images in camera.json"
            )
        notes.append(
            f"the intrinsics are of {camera.width}x{camera.height}, the {what} of {size[0]}x{size[1]}: "
            f"fx, fy, cx, cy were scaled by {size[0] / camera.width:.4g}"
        )
        return FittedCamera(_checked(camera.resized(*size), what), tuple(notes))
    return _by_principal_point(camera, what)


def _by_principal_point(camera: Camera, what: str) -> FittedCamera:
    ratio_x, ratio_y = (2 * camera.cx + 1) / camera.width, (2 * camera.cy + 1) / camera.height
    point = f"cx {camera.cx:g}, cy {camera.cy:g}"
    size = f"{camera.width}x{camera.height}"
    off = max(max(ratio, 1 / max(ratio, 1e-9)) for ratio in (ratio_x, ratio_y))
    if off < DOUBTFUL_RATIO:
        return FittedCamera(_checked(camera, what))
    own = Camera(round(2 * camera.cx + 1), round(2 * camera.cy + 1), camera.fx, camera.fy, camera.cx, camera.cy)
    if off >= CLEAR_RATIO and _same(ratio_x, ratio_y) and own.width >= MIN_WIDTH_PX:
        scale = 2 / (ratio_x + ratio_y)
        fitted = Camera(camera.width, camera.height, camera.fx * scale, camera.fy * scale, *_scaled(camera, scale))
        note = f"{point} are those of {what} of {own.width}x{own.height}, not {size}: fx, fy, cx, cy were scaled by "
        return FittedCamera(_checked(fitted, what), (f"{note}{scale:.4g}; state those of this size in camera.json",))
    if off >= 1.6 or not (0 <= camera.cx < camera.width and 0 <= camera.cy < camera.height):
        raise DataError(
            f"the principal point {point} is not near the middle of {what} of {size}, but would be of one of "
            f"{own.width}x{own.height}: state the intrinsics of these images in camera.json, in pixels"
        )
    return FittedCamera(
        _checked(camera, what),
        (f"the principal point {point} is far from the middle of {what} of {size}: is it right?",),
    )


def _scaled(camera: Camera, scale: float) -> tuple[float, float]:
    return (camera.cx + 0.5) * scale - 0.5, (camera.cy + 0.5) * scale - 0.5


def _same(first: float, second: float) -> bool:
    return abs(first / max(second, 1e-9) - 1) < SAME_RATIO


def _checked(camera: Camera, what: str) -> Camera:
    """`camera`. Raises DataError if its focal length cannot be in pixels."""
    if min(camera.fx / camera.width, camera.fy / camera.width) < MIN_FOCAL_RATIO:
        raise DataError(
            f"fx {camera.fx:g}, fy {camera.fy:g} are too short for {what} of {camera.width}x{camera.height}: they must "
            "be in pixels, not millimetres or parts of the image width"
        )
    return camera
