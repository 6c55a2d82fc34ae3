"""The whole inspection of a recording: what fits and what does not, in one list of findings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...core.correction import Correction, stated_poses
from ...core.errors import DataError
from ...core.events import OnEvent, Progress, ignore
from ...sensors.depth_statistics import depth_facts
from .correspondences import GAPS, InspectedFrames, Matches, depth_at, find_matches, frame_pairs
from .depth import depth_findings, noise_findings, relative_noise, voxel_finding
from .findings import Finding, Verdict, worst
from .geometry import MIN_EVIDENCE, Geometry, explain, geometry_findings
from .hypotheses import Evidence
from .images import image_facts, image_findings, repeated_images, time_stamps
from .registration import FRAMES, SCALES, Registration, measure_registration

SURE_HEIGHT, SURE_GAIN = 6.3, 3.0  # of a displacement of colour, in standard deviations
FEW_MATCHES = 40  # between neighbouring frames, below which tracking may fail
WRONG_PX, DOUBT_PX = 4.0, 3.0


@dataclass(frozen=True)
class Effort:
    """How much of a recording is read: frames from which pairs start, gaps to their partners, frames whose images are
    checked one by one, and matches of a sensor that take part at most."""

    anchors: int
    gaps: tuple[int, ...]
    images: int
    matches: int


THOROUGH = Effort(anchors=20, gaps=GAPS, images=FRAMES, matches=4000)
QUICK = Effort(anchors=8, gaps=(1, 8), images=10, matches=1500)


@dataclass(frozen=True)
class Inspection:
    """What was found: `fit`, how the parts of the recording fit one another, and `quality`, what single images show."""

    fit: tuple[Finding, ...]
    quality: tuple[Finding, ...]

    @property
    def findings(self) -> tuple[Finding, ...]:
        """All findings."""
        return self.fit + self.quality

    @property
    def first(self) -> Finding | None:
        """The first `wrong`, else the first `doubt`."""
        return worst(self.findings)

    @property
    def correction(self) -> Correction | None:
        """What mends the `wrong` findings that can be mended; None if there is none."""
        changes: dict[str, float | bool] = {}
        for finding in self.findings:
            if finding.verdict is Verdict.WRONG and finding.correction is not None:
                changes |= finding.correction.describe()
        return Correction(**changes) if changes else None  # type: ignore[arg-type]


def inspect_recording(
    frames: InspectedFrames,
    *,
    has_timestamps: bool,
    max_depth_m: float,
    sensors: Sequence[str] | None = None,
    effort: Effort = THOROUGH,
    on_event: OnEvent = ignore,
) -> Inspection:
    """Inspect a recording or the frames of a run; nothing is changed. `max_depth_m` is the range of the map."""
    chosen = tuple(sensors or frames.sensors)
    spread = [int(index) for index in np.unique(np.linspace(0, len(frames) - 1, effort.images).astype(int))]
    pairs = frame_pairs(len(frames), effort.anchors, effort.gaps)
    steps = 4

    def report(done: int) -> None:
        on_event(Progress("inspect", done, steps, "parts"))

    report(0)
    matches = find_matches(frames, pairs)
    report(1)
    registration = _best_registration(frames, chosen, spread, (1.0,))
    registered = _registration_finding(registration)
    moved = registered.correction if registered.verdict is Verdict.WRONG else None
    if moved is not None:  # geometry is judged with colour where it belongs
        offset = np.array([moved.color_x, moved.color_y])
        matches = replace(
            matches, pixels_first=matches.pixels_first + offset, pixels_second=matches.pixels_second + offset
        )
    report(2)
    facts = {sensor: depth_facts(frames, sensor, spread) for sensor in chosen}
    evidence = _evidence_by_sensor(frames, matches, chosen, effort.matches)
    geometry, noise = _judge(frames, evidence, has_timestamps, registration is not None and _is_sure(registration))
    if any(finding.verdict is not Verdict.OK for finding in geometry):
        scaled = _best_registration(frames, chosen, spread, SCALES)
        if scaled is not None and scaled.scale != 1.0 and _is_sure(scaled):
            registered = _registration_finding(scaled)
            geometry, noise = [], {}  # they were judged with colour that is not where depth is
    report(3)
    is_known = registered.verdict is not Verdict.UNKNOWN
    findings = [registered, *geometry] if is_known else [*geometry, registered]
    findings += noise_findings(noise, {sensor: one.quantiles[1] for sensor, one in facts.items() if one is not None})
    images = image_facts(frames, spread)
    findings.append(repeated_images(frames, images))
    quality: list[Finding] = []
    for sensor in chosen:
        quality += depth_findings(sensor, facts[sensor], max_depth_m, is_judged=sensor in noise)
    quality.append(voxel_finding([one for one in facts.values() if one is not None]))
    quality += image_findings(images)
    quality += [time_stamps(frames, has_timestamps), _overlap(matches, pairs)]
    report(steps)
    return Inspection(tuple(findings), tuple(quality))


def _evidence_by_sensor(
    frames: InspectedFrames, matches: Matches, sensors: Sequence[str], most: int
) -> dict[str, Evidence]:
    poses = stated_poses(frames)
    has_pose = np.isfinite(poses).all((1, 2))
    result = {}
    for sensor in sensors:
        first, second = np.zeros(len(matches)), np.zeros(len(matches))
        for index in np.unique(np.concatenate([matches.first, matches.second])):
            try:
                depth = frames.depth(int(index), sensor).numpy()
            except DataError:
                continue
            here = matches.first == index
            first[here] = depth_at(depth, matches.pixels_first[here])
            here = matches.second == index
            second[here] = depth_at(depth, matches.pixels_second[here])
        known = (first > 0) & (second > 0) & has_pose[matches.first] & has_pose[matches.second]
        evidence = Evidence(frames.camera, poses, matches.chosen(known), first[known], second[known])
        result[sensor] = evidence.thinned(most)
    return result


def _judge(
    frames: InspectedFrames, evidence: dict[str, Evidence], has_timestamps: bool, is_registered: bool
) -> tuple[list[Finding], dict[str, float]]:
    """Geometry by the sensor that agrees best, the depth scale of the others, and the noise of all."""
    usable = {sensor: one for sensor, one in evidence.items() if len(one) >= MIN_EVIDENCE}
    if not usable:
        text = "too few points are seen in two frames with depth and poses; units, intrinsics and poses are not judged"
        return [Finding("depth scale", Verdict.UNKNOWN, None, "", text)], {}
    explained = {sensor: explain(one) for sensor, one in usable.items()}
    best = min(explained, key=lambda sensor: _left(explained[sensor]))
    findings = geometry_findings(explained[best], usable[best], _frame_s(frames, has_timestamps))
    if not is_registered:
        findings = [_as_registration(finding) for finding in findings]
    accepted = explained[best].best
    correction = accepted.correction if accepted is not None else Correction()
    for sensor, geometry in explained.items():
        if sensor != best and geometry.best is not None and geometry.best.correction != correction:
            findings += _of_one_sensor(sensor, geometry, usable[sensor], correction)
    return findings, {sensor: relative_noise(one, correction) for sensor, one in usable.items()}


def _left(geometry: Geometry) -> float:
    return geometry.stated if geometry.best is None else geometry.best.cost


def _of_one_sensor(sensor: str, geometry: Geometry, evidence: Evidence, correction: Correction) -> list[Finding]:
    """An error of the depth of one sensor, where the others show none."""
    best = geometry.best
    if best is None or best.name not in ("depth scale", "along the ray"):
        return []
    if geometry.stated - evidence.cost(correction) > 0.5 * (geometry.stated - best.cost):
        return []  # what mends the others mends this sensor
    found = [one for one in geometry_findings(geometry, evidence, None) if one.verdict is not Verdict.OK]
    return [replace(one, check=f"{sensor}: {one.check}", correction=None) for one in found]


def _as_registration(finding: Finding) -> Finding:
    """A displaced principal point where the outlines could not show whether colour lies beside depth."""
    if finding.check != "intrinsics" or finding.unit != "pixels" or finding.correction is None:
        return finding
    x, y = -round(finding.correction.shift_x), -round(finding.correction.shift_y)
    return replace(finding, check="registration", remedy=f"move colour by ({x}, {y}) (--fix), or check the calibration",
                   correction=Correction(color_x=float(x), color_y=float(y)))  # fmt: skip


def _frame_s(frames: InspectedFrames, has_timestamps: bool) -> float | None:
    if not has_timestamps or len(frames) < 2:
        return None
    return float(np.median(np.diff([frames.timestamp(index) for index in range(len(frames))])))


def _best_registration(
    frames: InspectedFrames, sensors: Sequence[str], indices: Sequence[int], scales: Sequence[float]
) -> Registration | None:
    """Of the sensor whose outlines show it best; all sensors share one camera."""
    measured = measure_registration(frames, sensors, indices, scales)
    return max(measured.values(), key=lambda one: one.height, default=None)


def _is_sure(registration: Registration) -> bool:
    return registration.height >= SURE_HEIGHT


def _registration_finding(registration: Registration | None) -> Finding:
    check = "registration"
    if registration is None or not _is_sure(registration):
        return Finding(check, Verdict.UNKNOWN, None, "", "outlines in depth and colour do not show it")
    if registration.scale != 1.0:
        text = (
            f"colour fits depth best when depth is scaled by {registration.scale:.2f}: colour is of another "
            "calibration, or was not registered to depth"
        )
        return Finding(check, Verdict.WRONG, registration.scale, "factor", text,
                       "register colour to depth (color_camera in camera.json)")  # fmt: skip
    x, y = registration.x, registration.y
    pixels = float(np.hypot(x, y))
    text = f"colour lies ({x:.0f}, {y:.0f}) pixels (right, down) beside depth"
    if pixels >= DOUBT_PX and registration.gain >= SURE_GAIN:
        verdict = Verdict.WRONG if pixels >= WRONG_PX else Verdict.DOUBT
        return Finding(check, verdict, round(pixels, 1), "pixels", text, f"move it by ({-x:.0f}, {-y:.0f}) (--fix)",
                       Correction(color_x=-x, color_y=-y))  # fmt: skip
    return Finding(check, Verdict.OK, round(pixels, 1), "pixels", text)


def _overlap(matches: Matches, pairs: Sequence[tuple[int, int]]) -> Finding:
    neighbours = [pair for pair in pairs if pair[1] - pair[0] == 1]
    counts = [int(((matches.first == a) & (matches.second == b)).sum()) for a, b in neighbours]
    usual = float(np.median(counts)) if counts else 0.0
    verdict = Verdict.OK if usual >= FEW_MATCHES else Verdict.DOUBT
    text = f"{usual:.0f} points are seen in two neighbouring frames (median of {len(counts)} pairs)"
    return Finding("overlap", verdict, usual, "points", text, "tracking may fail; use poses, or record more slowly")
