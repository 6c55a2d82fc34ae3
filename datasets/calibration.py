"""Camera, depth scale and lens distortion of a recording, and the `camera.json` that states or overrides them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ..recon.camera import Camera
from ..recon.errors import DataError

CAMERA_FILE = "camera.json"


@dataclass(frozen=True)
class Calibration:
    """What turns the pixels of a recording into metres.

    depth_units_per_m   value of a depth pixel at a distance of one metre
    distortion          OpenCV's (k1, k2, p1, p2[, k3]) of colour and depth images; empty: already undistorted
    """

    camera: Camera
    depth_units_per_m: float = 1000.0
    distortion: tuple[float, ...] = ()


class CameraFile(BaseModel):
    """`camera.json`: see docs/own-data.md."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    width: int = Field(gt=0)
    height: int = Field(gt=0)
    fx: float = Field(gt=0, allow_inf_nan=False)
    fy: float = Field(gt=0, allow_inf_nan=False)
    cx: float = Field(allow_inf_nan=False)
    cy: float = Field(allow_inf_nan=False)
    depth_scale: float | None = Field(default=None, gt=0, allow_inf_nan=False)
    distortion: tuple[float, ...] = ()
    timestamps: str | None = None

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
            raise DataError(f"{path}: {where}: {first['msg']} (fields are described in docs/own-data.md)") from error
        except (OSError, UnicodeDecodeError) as error:
            raise DataError(f"cannot read {path}: {error}") from error
        if len(file.distortion) not in (0, 4, 5):
            raise DataError(f"{path}: distortion: expected k1, k2, p1, p2 and optionally k3, found {file.distortion}")
        return file

    def calibration(self, depth_units_per_m: float = 1000.0) -> Calibration:
        """The calibration stated here; `depth_units_per_m` holds where the file names no scale."""
        camera = Camera(self.width, self.height, self.fx, self.fy, self.cx, self.cy)
        return Calibration(camera, self.depth_scale or depth_units_per_m, self.distortion)


def calibration_or(folder: Path, default: Calibration) -> tuple[Calibration, tuple[str, ...]]:
    """`default`, unless `folder` holds a `camera.json`; and the note that says so. Raises DataError."""
    file = CameraFile.load(folder)
    if file is None:
        return default, ()
    return file.calibration(default.depth_units_per_m), (f"intrinsics are those of {CAMERA_FILE}",)
