"""Findings about units, intrinsics, pose convention and clock, from matched points.

The checks stand in one list: the one whose error explains the matches best is `wrong` (or `doubt`, where the gain is
small), the others are `ok`, because the matches agree once that error is taken out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ...core.correction import Correction
from .findings import Finding, Verdict
from .hypotheses import Evidence, Fit, fit, hypotheses, polish

MIN_EVIDENCE = 150  # matches with depth in both frames
MIN_GAIN = 0.03  # of the cost, below which a hypothesis explains nothing
DOUBT_RATIO, WRONG_RATIO = 0.85, 0.75  # cost with the hypothesis by the cost as stated
WRONG_GAIN = 0.08  # below it, the error does little harm, or the frames are too few to be sure of it
PARAMETER_PRICE = 0.005  # of the cost, for each free parameter
UNEXPLAINED = 0.5  # a cost as stated above which the poses do not fit the images, whatever the reason
POLISHED_FITS = 3
PLAUSIBLE_M = (0.1, 60.0)  # median depths of a recording
ROUND = (1.0, 2.0, 4.0, 5.0, 10.0)  # units are round: a factor close to one of these times a power of ten is meant
ROUND_TOLERANCE = 0.05
WHOLE = 0.1  # frames: a lag closer to a whole number is one
SMALL = {"scale": 0.06, "focal": 0.03, "pixels": 0.01, "lag": 0.4}  # deviations that nobody has to mend

CHECKS = ("depth scale", "pose scale", "depth along the ray", "intrinsics", "pose convention", "pose clock")


@dataclass(frozen=True)
class Geometry:
    """How well the matches agree as stated, the best explanation if there is one, and what is left with it."""

    stated: float
    best: Fit | None

    @property
    def is_wrong(self) -> bool:
        """Whether the explanation is so much better that the input must be wrong."""
        if self.best is None:
            return False
        return self.best.cost < WRONG_RATIO * self.stated and self.stated - self.best.cost > WRONG_GAIN


def explain(evidence: Evidence) -> Geometry:
    """The hypothesis that makes the matches agree best, if it is clearly better than the input as stated."""
    stated = evidence.cost(Correction())
    fits = sorted((fit(one, evidence) for one in hypotheses(evidence.camera)), key=_priced)
    polished = [polish(one, evidence) for one in fits[:POLISHED_FITS]]
    best = min((one for one in polished if _is_significant(one, evidence)), key=_priced, default=None)
    if best is None or stated - best.cost < MIN_GAIN or best.cost > DOUBT_RATIO * stated:
        return Geometry(stated, None)
    return Geometry(stated, best)


def geometry_findings(geometry: Geometry, evidence: Evidence, frame_s: float | None) -> list[Finding]:
    """One finding for each of `CHECKS`; `frame_s` is the usual time between frames, None without a clock."""
    best = geometry.best
    found = None if best is None else _finding(best, geometry, evidence, frame_s)
    agreement = f"{len(evidence)} matched points agree (cost {geometry.stated:.2f})"
    if best is None and geometry.stated > UNEXPLAINED:
        text = (
            f"matched points do not agree (cost {geometry.stated:.2f}), and no single error explains it: poses "
            "of other images, or several errors at once"
        )
        found = Finding("pose convention", Verdict.WRONG, round(geometry.stated, 3), "cost", text,
                        "check that poses, depth and intrinsics belong to these images")  # fmt: skip
    findings = []
    for check in CHECKS:
        if found is not None and found.check == check:
            findings.append(found)
        else:
            findings.append(Finding(check, Verdict.OK, round(geometry.stated, 3), "cost", agreement))
            agreement = "as above"
    return findings


def _priced(result: Fit) -> float:
    return result.cost + PARAMETER_PRICE * len(result.hypothesis.free)


def _is_significant(result: Fit, evidence: Evidence) -> bool:
    c = result.correction
    return (
        c.is_inverted
        or c.is_opengl
        or c.is_along_ray
        or abs(math.log(c.depth_factor)) > SMALL["scale"]
        or max(abs(math.log(c.focal_x)), abs(math.log(c.focal_y))) > SMALL["focal"]
        or math.hypot(c.shift_x, c.shift_y) > max(2.0, SMALL["pixels"] * evidence.camera.width)
        or abs(c.lag) > SMALL["lag"]
    )


def _finding(best: Fit, geometry: Geometry, evidence: Evidence, frame_s: float | None) -> Finding:
    verdict = Verdict.WRONG if geometry.is_wrong else Verdict.DOUBT
    c = best.correction
    ending = f" (cost {geometry.stated:.2f} as stated, {best.cost:.2f} so)"
    if c.is_inverted or c.is_opengl:
        text, remedy = _convention(c)
        if abs(math.log(c.depth_factor)) < SMALL["scale"]:
            c = replace(c, depth_factor=1.0)
        else:
            c, scale_text, _ = _scale(c, evidence)
            text += ", and " + scale_text
        return Finding("pose convention", verdict, None, "", text + ending, remedy, c)
    if best.name == "depth scale":
        c, text, remedy = _scale(c, evidence)
        is_depth = c.translation_factor == 1.0
        value = c.depth_factor if is_depth else c.translation_factor
        check = "depth scale" if is_depth else "pose scale"
        return Finding(check, verdict, float(f"{value:.4g}"), "factor", text + ending, remedy, c)
    if best.name == "lag":
        c = _whole_frames(c)
        return Finding("pose clock", verdict, *_clock(c, frame_s, ending), c)
    if best.name == "along the ray":
        text = "depth is a distance from the camera centre, not along its optical axis"
        return Finding("depth along the ray", verdict, None, "", text + ending, "convert it, or use --fix", c)
    return Finding("intrinsics", verdict, *_intrinsics(best, evidence, ending), c)


def _convention(c: Correction) -> tuple[str, str]:
    parts = []
    if c.is_inverted:
        parts.append("poses are camera from world (inverted)")
    if c.is_opengl:
        parts.append("camera axes are OpenGL's (right, up, backwards)")
    return " and ".join(parts), "give T_world_camera in OpenCV axes (right, down, forward), or use --fix"


def _scale(c: Correction, evidence: Evidence) -> tuple[Correction, str, str]:
    """Whether depth or poses have the wrong unit: the one that is not plausible by itself."""
    factor = _rounded(c.depth_factor)
    depth = float(np.median(evidence.depth_first))
    low, high = PLAUSIBLE_M
    if low <= depth <= high and not low <= depth * factor <= high:
        unit = {1000.0: "millimetres", 100.0: "centimetres", 0.001: "kilometres"}.get(factor)
        named = f"in {unit}" if unit else f"{factor:.4g} times too large"
        text = f"positions of the camera are {named}: depth and parallax agree with {1 / factor:.4g} of them"
        remedy = f"multiply the positions by {1 / factor:.4g}, or use --fix"
        return replace(c, depth_factor=1.0, translation_factor=1 / factor), text, remedy
    wrong = f"{1 / factor:.4g} times too large" if factor < 1 else f"{factor:.4g} times too small"
    text = f"depth (median {depth:.3g} m) is {wrong}, by the parallax between frames"
    remedy = f"divide the depth_scale (units per metre) by {factor:.4g}, or use --fix"
    return replace(c, depth_factor=factor), text, remedy


def _rounded(factor: float) -> float:
    power = 10.0 ** math.floor(math.log10(factor))
    nearest = min((number * power for number in ROUND), key=lambda number: abs(math.log(factor / number)))
    return nearest if abs(math.log(factor / nearest)) < ROUND_TOLERANCE else factor


def _clock(c: Correction, frame_s: float | None, ending: str) -> tuple[float, str, str, str]:
    frames = round(c.lag, 2)
    milliseconds = "" if frame_s is None else f", {1e3 * frame_s * c.lag:.0f} ms"
    direction = "later" if c.lag > 0 else "earlier"
    text = f"images fit the poses of {abs(frames):.4g} frames{milliseconds.replace('-', '')} {direction}" + ending
    return frames, "frames", text, "shift the time stamps of the poses by as much, or use --fix"


def _intrinsics(best: Fit, evidence: Evidence, ending: str) -> tuple[float, str, str, str]:
    c, camera = best.correction, evidence.camera
    fixed = c.camera(camera)
    numbers = f"fx {fixed.fx:.1f}, fy {fixed.fy:.1f}, cx {fixed.cx:.1f}, cy {fixed.cy:.1f}"
    remedy = f"check the calibration; {numbers} would fit (--fix uses them)"
    if best.name == "principal point":
        text = f"the principal point is off by ({c.shift_x:.0f}, {c.shift_y:.0f}) pixels, or colour lies beside depth"
        return round(math.hypot(c.shift_x, c.shift_y), 1), "pixels", text + ending, remedy
    factor = c.focal_x if c.focal_x != 1.0 else c.focal_y
    if best.name == "image size":
        text = f"intrinsics are of an image of {1 / factor:.3g} times the size"
    else:
        axis = {"focal length": "", "focal length x": " along x", "focal length y": " along y"}[best.name]
        text = f"the focal length{axis} should be {factor:.3g} times as large"
    return round(factor, 3), "factor", text + ending, remedy


def _whole_frames(c: Correction) -> Correction:
    """Poses of other images are off by whole frames; of another clock, by any time."""
    return replace(c, lag=float(round(c.lag))) if abs(c.lag - round(c.lag)) < WHOLE else c
