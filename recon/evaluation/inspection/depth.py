"""Findings about each sensor's depth: range, fill, noise, and names that seem to be exchanged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ...core.correction import Correction
from ...sensors.depth_statistics import DepthFacts
from ...sensors.voxel_size import fitting_voxel_size
from .findings import Finding, Verdict
from .hypotheses import LOG_DEPTH, Evidence

EMPTY = 0.1  # fill below which a sensor says little
PLAUSIBLE_M = (0.1, 30.0)
MORE_NOISE = 1.4  # ratio of noise above which two names seem to be exchanged
# How noisy sensors of these names usually are: the kinds of `uncle synth`, SenFuNet's rooms and common names.
NOISE_RANK = {"gt": 0, "sl": 1, "tof": 1, "kinect": 1, "sgm": 2, "dense": 2, "psmnet": 2, "stereo": 2, "mono": 3}


def depth_findings(sensor: str, facts: DepthFacts | None, max_depth_m: float, is_judged: bool) -> list[Finding]:
    """Range and fill of one sensor; `is_judged`: its scale was judged by parallax already."""
    if facts is None:
        return [Finding(f"{sensor}: depth", Verdict.WRONG, 0.0, "share", "no depth image has a measurement",
                        "leave the sensor out (--sensors), or check its files and depth_scale")]  # fmt: skip
    low, middle, high = facts.quantiles
    text = f"{low:.2f} to {high:.2f} m (5 to 95 %), median {middle:.2f} m"
    verdict, remedy = Verdict.OK, ""
    if not is_judged and not PLAUSIBLE_M[0] <= middle <= PLAUSIBLE_M[1]:
        verdict, remedy = Verdict.DOUBT, "check depth_scale (units per metre)"
    elif middle > max_depth_m:
        verdict, remedy = Verdict.DOUBT, f"most of it is beyond max_depth_m = {max_depth_m:g}; raise it with --set"
    range_finding = Finding(f"{sensor}: range", verdict, round(middle, 3), "m", text, remedy)
    fill_text = f"{facts.fill:.0%} of the pixels have a measurement in a usual image"
    if facts.empty:
        fill_text += f"; {facts.empty} of {facts.images} images that were tried have none"
    fill_verdict = Verdict.DOUBT if facts.fill < EMPTY or facts.empty > 0.3 * facts.images else Verdict.OK
    return [range_finding, Finding(f"{sensor}: fill", fill_verdict, round(facts.fill, 3), "share", fill_text)]


def relative_noise(evidence: Evidence, correction: Correction) -> float:
    """Median disagreement of depth between two frames of a point, as a share of depth, of one frame."""
    difference = np.abs(evidence.residuals(correction)[:, 2]) * LOG_DEPTH
    difference = difference[np.isfinite(difference)]
    return float(np.median(difference) / np.sqrt(2)) if len(difference) else float("nan")


def noise_findings(noise: Mapping[str, float], medians: Mapping[str, float]) -> list[Finding]:
    """Noise of each sensor, and pairs of sensors whose noise contradicts their names."""
    findings = []
    for sensor, share in noise.items():
        centimetres = 100 * share * medians.get(sensor, float("nan"))
        text = (
            f"points seen twice differ by {share:.1%} of their depth, {centimetres:.1f} cm in the middle of the range"
        )
        findings.append(Finding(f"{sensor}: noise", Verdict.OK, round(100 * share, 2), "%", text))
    for first in noise:
        for second in noise:
            rank_first, rank_second = NOISE_RANK.get(first.lower()), NOISE_RANK.get(second.lower())
            if rank_first is None or rank_second is None or rank_first >= rank_second:
                continue
            if noise[first] > MORE_NOISE * noise[second]:
                times = noise[first] / noise[second]
                text = f"{first} is {times:.1f} times as noisy as {second}: the two seem to be exchanged"
                findings.append(Finding("sensor names", Verdict.WRONG, round(noise[first] / noise[second], 2), "factor",
                                        text, "check which folder belongs to which sensor"))  # fmt: skip
                return findings
    return findings


def voxel_finding(facts: Sequence[DepthFacts]) -> Finding:
    """The voxel size that a map has unless it is set."""
    fitting = fitting_voxel_size(facts)
    millimetres = round(1000 * fitting.size_m, 3)
    text = f"{100 * fitting.size_m:g} cm fits ({fitting.reason})"
    return Finding("voxel size", Verdict.OK, millimetres, "mm", text)
