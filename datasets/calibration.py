"""Cameras, depth scale and lens distortion of a recording, and the `camera.json` that states or overrides them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from ..recon.core.camera import Camera
from ..recon.core.errors import DataError
from ..recon.core.json_values import first_problem
from ..recon.core.pose import usable_pose
from ..recon.core.text import read_text

CAMERA_FILE = "camera.json"
MAX_DEPTH_SCALE = 1e7  # units of 0.1 micrometres
MAX_SIZE_PX = 100_000
MAX_FOCAL_PX = 1e7  # the field of view is then 1/100 degree; no depth sensor has one
MIN_DEPTH_SCALE = 0.5  # depth in metres as floats has 1; less is metres a unit
# Names of OpenCV, COLMAP and ROS, and whether the model is the fisheye one.
DISTORTION_MODELS = {
    "opencv": False,
    "full_opencv": False,
    "plumb_bob": False,
    "rational_polynomial": False,
    "fisheye": True,
    "opencv_fisheye": True,
    "equidistant": True,
}
MAX_BASELINE_M = 1.0  # no hand-held rig is wider; a larger number is a translation in millimetres


@dataclass(frozen=True)
class Calibration:
    """How the images of a recording become frames in metres.

    camera              of the depth images
    depth_units_per_m   value of a depth pixel at a distance of one metre
    distortion          OpenCV's coefficients of colour and depth images; empty: already undistorted
    is_fisheye          whether they are those of OpenCV's fisheye model (k1, k2, k3, k4)
    color_camera        of the colour images where another camera took them; None: they are registered to depth
    T_color_depth       (4, 4) from the axes of `camera` to those of `color_camera`, metres; None without the latter
    color_distortion, color_is_fisheye   of the colour images of `color_camera`; the above are of depth alone then
    registration_sigma_px  how far colour may lie beside the depth it belongs to, by an error that all frames share
    resize_color        registered colour of another size is resampled to the size of the depth images; else an error
    margin_px           pixels to cut from every side of every image
    """

    camera: Camera
    depth_units_per_m: float = 1000.0
    distortion: tuple[float, ...] = ()
    is_fisheye: bool = False
    color_camera: Camera | None = None
    T_color_depth: np.ndarray | None = None
    color_distortion: tuple[float, ...] = ()
    color_is_fisheye: bool = False
    registration_sigma_px: float = 0.0
    resize_color: bool = False
    margin_px: int = 0


class CameraFields(BaseModel):
    """A camera as `camera.json` states it."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    width: int = Field(gt=0, le=MAX_SIZE_PX)
    height: int = Field(gt=0, le=MAX_SIZE_PX)
    fx: float = Field(gt=0, le=MAX_FOCAL_PX)
    fy: float = Field(gt=0, le=MAX_FOCAL_PX)
    cx: float = Field(allow_inf_nan=False)
    cy: float = Field(allow_inf_nan=False)
    distortion: tuple[Annotated[float, Field(allow_inf_nan=False)], ...] = ()
    distortion_model: str = "opencv"

    @model_validator(mode="before")
    @classmethod
    def _matrix(cls, values: Any) -> Any:
        """Open3D's `intrinsic_matrix`, column by column (or row by row), in place of fx, fy, cx, cy."""
        if not isinstance(values, dict) or "intrinsic_matrix" not in values:
            return values
        others = {key: value for key, value in values.items() if key != "intrinsic_matrix"}
        return others | intrinsics_of_matrix(np.array(values["intrinsic_matrix"], dtype=float))

    @model_validator(mode="after")
    def _known_distortion(self) -> CameraFields:
        count = len(self.distortion)
        if self.distortion_model not in DISTORTION_MODELS:
            raise ValueError(f"distortion_model {self.distortion_model!r} is none of {', '.join(DISTORTION_MODELS)}")
        wanted = (0, 4) if self.is_fisheye else (0, 4, 5, 8, 12, 14)
        if count not in wanted:
            names = "k1, k2, k3, k4" if self.is_fisheye else "k1, k2, p1, p2[, k3[, k4, k5, k6]]"
            raise ValueError(f"distortion: expected {names}, found {count} numbers: {self.distortion}")
        return self

    @property
    def is_fisheye(self) -> bool:
        """Whether `distortion` is that of OpenCV's fisheye model."""
        return DISTORTION_MODELS[self.distortion_model]

    @property
    def camera(self) -> Camera:
        """The pinhole part, without distortion."""
        return Camera(self.width, self.height, self.fx, self.fy, self.cx, self.cy)


class CameraFile(CameraFields):
    """`camera.json`: see docs/data-formats.md."""

    depth_scale: float | None = Field(default=None, gt=0, le=MAX_DEPTH_SCALE)
    timestamps: str | None = None
    color_camera: CameraFields | None = None
    T_color_depth: tuple[tuple[float, ...], ...] | None = None
    registration_sigma_px: float = Field(default=0.0, ge=0, allow_inf_nan=False)

    @field_validator("depth_scale")
    @classmethod
    def _units_per_metre(cls, value: float | None) -> float | None:
        if value is not None and value < MIN_DEPTH_SCALE:
            raise ValueError(
                f"{value:g} is inverted: it is the value of a depth pixel at one metre, and {value:g} metres a unit "
                f'is "depth_scale": {1 / value:.6g}'
            )
        return value

    @field_validator("T_color_depth")
    @classmethod
    def _rigid(cls, rows: tuple[tuple[float, ...], ...] | None) -> tuple[tuple[float, ...], ...] | None:
        if rows is None:
            return None
        square = len(rows) == 4 and all(len(row) == 4 for row in rows)
        pose = usable_pose(np.array(rows)).T_world_camera if square else None
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
    def load(path: Path) -> CameraFile:
        """The file `path`. Raises DataError naming the bad field."""
        try:
            file = CameraFile.model_validate_json(read_text(path))
        except ValidationError as error:
            raise DataError(f"{path}: {first_problem(error)} (fields are described in docs/data-formats.md)") from error
        return file

    def calibration(self, depth_units_per_m: float = 1000.0) -> Calibration:
        """The calibration stated here; `depth_units_per_m` holds where the file names no scale."""
        calibration = Calibration(
            self.camera,
            self.depth_scale or depth_units_per_m,
            self.distortion,
            self.is_fisheye,
            registration_sigma_px=self.registration_sigma_px,
        )
        if self.color_camera is None:
            return calibration
        return replace(
            calibration,
            color_camera=self.color_camera.camera,
            T_color_depth=np.array(self.T_color_depth),
            color_distortion=self.color_camera.distortion,
            color_is_fisheye=self.color_camera.is_fisheye,
        )


def intrinsics_of_matrix(values: np.ndarray) -> dict[str, float]:
    """fx, fy, cx, cy of a matrix of 3x3, 3x4 or 4x4 numbers, or 9 of them in rows or columns.

    Raises ValueError if it is none: fx 0 cx / 0 fy cy / 0 0 1.
    """
    if values.size not in (9, 12, 16):
        raise ValueError(f"an intrinsic matrix has 3x3 numbers, found {values.size}")
    matrix = values.reshape(3, 3) if values.size == 9 else values.reshape(-1, 4)[:3, :3]
    if not matrix[:2, 2].any():
        matrix = matrix.T  # column by column, as Open3D writes it
    zeros = [matrix[1, 0], matrix[2, 0], matrix[2, 1], matrix[2, 2] - 1]
    if not np.isfinite(matrix).all() or np.abs(zeros).max() > 1e-6 or min(matrix[0, 0], matrix[1, 1]) <= 0:
        raise ValueError("an intrinsic matrix has the rows `fx 0 cx`, `0 fy cy`, `0 0 1`")
    return {"fx": float(matrix[0, 0]), "fy": float(matrix[1, 1]), "cx": float(matrix[0, 2]), "cy": float(matrix[1, 2])}
