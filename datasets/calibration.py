"""Cameras, depth scale and lens distortion of a recording, and the `camera.json` that states or overrides them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from ..recon.core.camera import Camera
from ..recon.core.errors import DataError
from .poses import checked_pose

CAMERA_FILE = "camera.json"
MAX_BASELINE_M = 1.0  # no hand-held rig is wider; a larger number is a translation in millimetres


@dataclass(frozen=True)
class Calibration:
    """How the images of a recording become frames in metres.

    camera              of the depth images
    depth_units_per_m   value of a depth pixel at a distance of one metre
    distortion          OpenCV's (k1, k2, p1, p2[, k3]) of colour and depth images; empty: already undistorted
    color_camera        of the colour images where another camera took them; None: they are registered to depth
    T_color_depth       (4, 4) from the axes of `camera` to those of `color_camera`, metres; None without the latter
    color_distortion    of the colour images of `color_camera`; `distortion` is of the depth images alone then
    registration_sigma_px  how far colour may lie beside the depth it belongs to, by an error that all frames share
    resize_color        registered colour of another size is resampled to the size of the depth images; else an error
    margin_px           pixels to cut from every side of every image
    """

    camera: Camera
    depth_units_per_m: float = 1000.0
    distortion: tuple[float, ...] = ()
    color_camera: Camera | None = None
    T_color_depth: np.ndarray | None = None
    color_distortion: tuple[float, ...] = ()
    registration_sigma_px: float = 0.0
    resize_color: bool = False
    margin_px: int = 0


class CameraFields(BaseModel):
    """A camera as `camera.json` states it."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    width: int = Field(gt=0)
    height: int = Field(gt=0)
    fx: float = Field(gt=0, allow_inf_nan=False)
    fy: float = Field(gt=0, allow_inf_nan=False)
    cx: float = Field(allow_inf_nan=False)
    cy: float = Field(allow_inf_nan=False)
    distortion: tuple[float, ...] = ()

    @field_validator("distortion")
    @classmethod
    def _known_model(cls, values: tuple[float, ...]) -> tuple[float, ...]:
        if len(values) not in (0, 4, 5):
            raise ValueError(f"expected k1, k2, p1, p2 and optionally k3, found {values}")
        return values

    @property
    def camera(self) -> Camera:
        """The pinhole part, without distortion."""
        return Camera(self.width, self.height, self.fx, self.fy, self.cx, self.cy)


class CameraFile(CameraFields):
    """`camera.json`: see docs/data-formats.md."""

    depth_scale: float | None = Field(default=None, gt=0, allow_inf_nan=False)
    timestamps: str | None = None
    color_camera: CameraFields | None = None
    T_color_depth: tuple[tuple[float, ...], ...] | None = None
    registration_sigma_px: float = Field(default=0.0, ge=0, allow_inf_nan=False)

    @field_validator("T_color_depth")
    @classmethod
    def _rigid(cls, rows: tuple[tuple[float, ...], ...] | None) -> tuple[tuple[float, ...], ...] | None:
        if rows is None:
            return None
        square = len(rows) == 4 and all(len(row) == 4 for row in rows)
        pose = checked_pose(np.array(rows)) if square else None
        if pose is None:
            raise ValueError("expected 4 rows of 4 numbers: a rotation and a translation, the last row 0 0 0 1")
        if np.linalg.norm(pose[:3, 3]) > MAX_BASELINE_M:
            raise ValueError(f"its translation {pose[:3, 3].tolist()} is no distance of two cameras in metres")
        return tuple(map(tuple, pose.tolist()))

    @model_validator(mode="after")
    def _both_or_neither(self) -> CameraFile:
        if (self.color_camera is None) != (self.T_color_depth is None):
            missing = "T_color_depth" if self.T_color_depth is None else "color_camera"
            raise ValueError(f"color_camera and T_color_depth belong together, but {missing} is missing")
        return self

    @staticmethod
    def load(folder: Path) -> CameraFile | None:
        """The `camera.json` of `folder`, None if there is none. Raises DataError naming the bad field."""
        path = folder / CAMERA_FILE
        if not path.is_file():
            return None
        try:
            file = CameraFile.model_validate_json(path.read_text())
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"]) or "the file"
            what = first["msg"].removeprefix("Value error, ")
            raise DataError(f"{path}: {where}: {what} (fields are described in docs/data-formats.md)") from error
        except (OSError, UnicodeDecodeError) as error:
            raise DataError(f"cannot read {path}: {error}") from error
        return file

    def calibration(self, depth_units_per_m: float = 1000.0) -> Calibration:
        """The calibration stated here; `depth_units_per_m` holds where the file names no scale."""
        calibration = Calibration(
            self.camera,
            self.depth_scale or depth_units_per_m,
            self.distortion,
            registration_sigma_px=self.registration_sigma_px,
        )
        if self.color_camera is None:
            return calibration
        return replace(
            calibration,
            color_camera=self.color_camera.camera,
            T_color_depth=np.array(self.T_color_depth),
            color_distortion=self.color_camera.distortion,
        )


def calibration_or(folder: Path, default: Calibration) -> tuple[Calibration, tuple[str, ...]]:
    """`default`, unless `folder` holds a `camera.json`; and the note that says so. Raises DataError."""
    file = CameraFile.load(folder)
    if file is None:
        return default, ()
    return file.calibration(default.depth_units_per_m), (f"intrinsics are those of {CAMERA_FILE}",)
