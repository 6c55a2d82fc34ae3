"""Which misreading of depth, intrinsics or poses would make matched points agree.

A point that two frames show has one place in the world: its depth in the first frame, moved by the poses, predicts
pixel and depth in the second. Each hypothesis about an error of the input is fitted to that; the one that makes the
points agree best, clearly better than the data as stated, names the error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import least_squares, minimize

from ...core.camera import Camera
from ...core.correction import Correction
from ...core.se3 import inverse, transform
from .correspondences import Matches

ANGLE_RAD = 0.01  # errors of a pixel's direction, and of the logarithm of a depth, that are taken for small
LOG_DEPTH = 0.05
LAGS = tuple(np.arange(-12.0, 12.5, 0.5))  # frames
LOG_SCALES = tuple(np.linspace(-7.5, 7.5, 31) * np.log(10.0) / 2.5)
LOG_FOCALS = tuple(np.log([0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.25, 1.4, 1.6, 2.0]))
ROUGH, POLISHED = 1000, 2000  # matches that take part in choosing and fitting starting values, and in polishing
STARTS = 3  # of the grid of starting values, the best are fitted


@dataclass(frozen=True)
class Hypothesis:
    """A kind of error: what is fixed, and which of `_PARAMETERS` are free, with their starting values."""

    name: str
    fixed: Correction = field(default_factory=Correction)
    free: tuple[str, ...] = ()
    starts: tuple[tuple[float, ...], ...] = ((),)


@dataclass(frozen=True)
class Fit:
    """A hypothesis fitted to the matches; `cost` in [0, 1], 0 = all points agree."""

    hypothesis: Hypothesis
    values: tuple[float, ...]
    correction: Correction
    cost: float

    @property
    def name(self) -> str:
        """The name of the hypothesis."""
        return self.hypothesis.name


@dataclass(frozen=True)
class Evidence:
    """Matches with the depth (N,) of one sensor in both frames, metres, and all poses (F, 4, 4) of the recording."""

    camera: Camera
    poses: np.ndarray
    matches: Matches
    depth_first: np.ndarray
    depth_second: np.ndarray

    def __len__(self) -> int:
        return len(self.matches)

    def thinned(self, count: int) -> Evidence:
        """At most `count` matches, evenly chosen."""
        if len(self) <= count:
            return self
        keep = np.linspace(0, len(self) - 1, count).astype(int)
        return replace(
            self,
            matches=self.matches.chosen(keep),
            depth_first=self.depth_first[keep],
            depth_second=self.depth_second[keep],
        )

    def residuals(self, correction: Correction) -> np.ndarray:
        """(N, 3): direction in the second camera (x, y) and logarithm of depth, in units of what is small.

        Points that cannot be judged (poses beyond the ends of the recording) are NaN, those behind a camera infinite.
        """
        poses = correction.poses(self.poses)
        first, second = poses[self.matches.first], poses[self.matches.second]
        rays_first = self._rays(self.matches.pixels_first, correction)
        rays_second = self._rays(self.matches.pixels_second, correction)
        z_first = self._z(self.depth_first, rays_first, correction)
        z_second = self._z(self.depth_second, rays_second, correction)
        moved = transform(inverse(second), transform(first, rays_first * z_first[:, None]))
        z = moved[:, 2]
        front = z > 1e-9
        safe = np.where(front, z, 1.0)
        direction = (moved[:, :2] / safe[:, None] - rays_second[:, :2]) / ANGLE_RAD
        log_depth = np.log(safe / z_second) / LOG_DEPTH
        result = np.column_stack([direction, log_depth])
        result[~front] = np.where(np.isnan(z[~front, None]), np.nan, np.inf)
        return result

    def cost(self, correction: Correction) -> float:
        """Mean over the matches of r^2 / (1 + r^2), r the length of a match's residuals; 1 if none can be judged."""
        square = np.square(self.residuals(correction)).sum(-1)
        square = square[~np.isnan(square)]
        if len(square) < 0.3 * len(self):
            return 1.0
        return float(np.mean(1.0 - 1.0 / (1.0 + square)))

    def _rays(self, pixels: np.ndarray, correction: Correction) -> np.ndarray:
        x, y = correction.camera(self.camera).unproject(pixels[:, 0], pixels[:, 1])
        return np.column_stack([x, y, np.ones_like(x)])

    @staticmethod
    def _z(depth: np.ndarray, rays: np.ndarray, correction: Correction) -> np.ndarray:
        z = depth * correction.depth_factor
        result: np.ndarray = z / np.linalg.norm(rays, axis=1) if correction.is_along_ray else z
        return result


_PARAMETERS = {
    "log_scale": lambda r, v: replace(r, depth_factor=r.depth_factor * float(np.exp(v))),
    "log_focal": lambda r, v: replace(r, focal_x=float(np.exp(v)), focal_y=float(np.exp(v))),
    "log_fx": lambda r, v: replace(r, focal_x=float(np.exp(v))),
    "log_fy": lambda r, v: replace(r, focal_y=float(np.exp(v))),
    "shift_x": lambda r, v: replace(r, shift_x=100.0 * float(v)),
    "shift_y": lambda r, v: replace(r, shift_y=100.0 * float(v)),
    "lag": lambda r, v: replace(r, lag=float(v)),
}


def correction_of(hypothesis: Hypothesis, values: Sequence[float] | np.ndarray) -> Correction:
    """The correction with the free parameters set."""
    correction = hypothesis.fixed
    for name, value in zip(hypothesis.free, values, strict=True):
        correction = _PARAMETERS[name](correction, value)
    return correction


def other_sizes(camera: Camera) -> tuple[tuple[float, ...], ...]:
    """Starting values (focal, shift x, shift y) of intrinsics that belong to an image of another size."""
    factors = (0.25, 0.3, 0.5, 0.6, 2 / 3, 0.8, 1.25, 1.5, 1.6, 2.0, 3.0, 4.0)  # of focal length and principal point
    return tuple((float(np.log(f)), (f - 1) * camera.cx / 100, (f - 1) * camera.cy / 100) for f in factors)


def hypotheses(camera: Camera) -> tuple[Hypothesis, ...]:
    """Every error that is looked for."""
    scales = tuple((value,) for value in LOG_SCALES)
    focals = tuple((value,) for value in LOG_FOCALS)
    inverted, opengl = Correction(is_inverted=True), Correction(is_opengl=True)
    both = Correction(is_inverted=True, is_opengl=True)
    return (
        Hypothesis("depth scale", free=("log_scale",), starts=scales),
        Hypothesis("inverted", inverted),
        Hypothesis("opengl", opengl),
        Hypothesis("inverted opengl", both),
        Hypothesis("inverted, depth scale", inverted, ("log_scale",), scales),
        Hypothesis("opengl, depth scale", opengl, ("log_scale",), scales),
        Hypothesis("inverted opengl, depth scale", both, ("log_scale",), scales),
        Hypothesis("focal length", free=("log_focal",), starts=focals),
        Hypothesis("focal length x", free=("log_fx",), starts=focals),
        Hypothesis("focal length y", free=("log_fy",), starts=focals),
        Hypothesis("image size", free=("log_focal", "shift_x", "shift_y"), starts=other_sizes(camera)),
        Hypothesis(
            "principal point",
            free=("shift_x", "shift_y"),
            starts=((0.0, 0.0), (0.3, 0), (-0.3, 0), (0, 0.3), (0, -0.3)),
        ),
        Hypothesis("lag", free=("lag",), starts=tuple((value,) for value in LAGS if value)),
        Hypothesis("along the ray", Correction(is_along_ray=True)),
    )


def fitted(hypothesis: Hypothesis, values: Sequence[float] | np.ndarray, evidence: Evidence) -> Fit:
    """The fit with given values of the free parameters."""
    correction = correction_of(hypothesis, values)
    return Fit(hypothesis, tuple(map(float, values)), correction, evidence.cost(correction))


def fit(hypothesis: Hypothesis, evidence: Evidence) -> Fit:
    """The free parameters that make the matches agree best, from the best of the starting values."""
    if not hypothesis.free:
        return fitted(hypothesis, (), evidence)
    rough = evidence.thinned(ROUGH)
    ranked = sorted(hypothesis.starts, key=lambda start: rough.cost(correction_of(hypothesis, start)))
    fits = [fitted(hypothesis, _least_squares(hypothesis, start, rough), evidence) for start in ranked[:STARTS]]
    return min(fits, key=lambda one: one.cost)


def polish(result: Fit, evidence: Evidence) -> Fit:
    """The fit with its cost itself minimised, which is slower than least squares and less easily led astray."""
    if not result.hypothesis.free:
        return result
    rough = evidence.thinned(POLISHED)

    def cost(values: np.ndarray) -> float:
        return rough.cost(correction_of(result.hypothesis, values))

    found = minimize(cost, result.values, method="Nelder-Mead", options={"xatol": 1e-4, "fatol": 1e-5, "maxfev": 150})
    polished = fitted(result.hypothesis, tuple(found.x), evidence)
    return min(polished, result, key=lambda one: one.cost)


def _least_squares(hypothesis: Hypothesis, start: Sequence[float], evidence: Evidence) -> np.ndarray:

    def residuals(values: np.ndarray) -> np.ndarray:
        found = evidence.residuals(correction_of(hypothesis, values)).ravel()
        return np.nan_to_num(found, nan=0.0, posinf=1e3, neginf=-1e3)

    steps = np.array([1e-2]) if hypothesis.free == ("lag",) else None  # interpolated poses bend at whole frames
    solution = least_squares(residuals, start, loss="cauchy", max_nfev=25, diff_step=steps)
    return min((solution.x, np.asarray(start)), key=lambda values: evidence.cost(correction_of(hypothesis, values)))
