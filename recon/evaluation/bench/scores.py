"""What of `RUN/metrics.json` is compared, flat: SI units, ratios 0..1; what was not scored is left out."""

from __future__ import annotations

from .process import Record
from .statistics import Metric

SURFACE = (
    Metric("F 5 cm %", "f_score_5cm", 100, 2, 1), Metric("F 2 cm %", "f_score_2cm", 100, 2, 1),
    Metric("P 5 cm %", "precision_5cm", 100, 2, 1), Metric("R 5 cm %", "recall_5cm", 100, 2, 1),
    Metric("accuracy cm", "accuracy_mean_m", 100, 3, -1), Metric("completeness cm", "completeness_mean_m", 100, 3, -1),
    Metric("depth L1 cm", "depth_l1_m", 100, 3, -1),
    Metric("held-out L1 cm", "held_out_l1_m", 100, 3, -1), Metric("held-out seen %", "held_out_seen", 100, 2, 1),
    Metric("held-out PSNR dB", "held_out_psnr_db", 1, 2, 1),
)  # fmt: skip
TRAJECTORY = (
    Metric("ATE cm", "ate_m", 100, 3, -1), Metric("ATE aligned cm", "ate_aligned_m", 100, 3, -1),
    Metric("frames with a pose %", "posed", 100, 1, 1),
)  # fmt: skip
COSTS = (
    Metric("frames/s", "frames_per_s", 1, 2, 0), Metric("map s", "wall_s", 1, 1, 0),
    Metric("peak MB", "peak_memory_mb", 1, 0, 0), Metric("GPU MB", "gpu_memory_mb", 1, 0, 0),
)  # fmt: skip
TRUST = (
    Metric("NLL nats", "nll_nats", 1, 3, -1), Metric("NLL constant", "nll_constant_nats", 1, 3, 0),
    Metric("50 % covers %", "coverage_50", 100, 1, 0), Metric("90 % covers %", "coverage_90", 100, 1, 0),
    Metric("calibrated 50 %", "calibrated_coverage_50", 100, 1, 0),
    Metric("calibrated 90 %", "calibrated_coverage_90", 100, 1, 0),
    Metric("AUSE", "ause", 1, 3, -1), Metric("rank corr.", "rank_correlation", 1, 3, 1),
    Metric("closer than depth alone %", "ause_gain", 100, 1, 1),
)  # fmt: skip
UNCERTAINTY = tuple(metric.key for metric in TRUST)


def surface_scores(surface: Record) -> Record:
    """F, precision and recall by threshold and the mean distances of a scored mesh."""
    found: Record = {}
    for score in surface["mesh"]["scores"]:
        at = f"{round(score['threshold_m'] * 100)}cm"
        found |= {f"{name}_{at}": score[name] for name in ("f_score", "precision", "recall")}
    means = ("accuracy_mean_m", "completeness_mean_m")
    return found | {name: surface["mesh"][name] for name in means if name in surface["mesh"]}


def scores(metrics: Record) -> Record:
    """Surface, held-out depth and colour and, by sensor, uncertainty."""
    found: Record = surface_scores(metrics["surface"]) if metrics.get("surface") else {}
    if views := (metrics.get("surface") or {}).get("novel_views"):
        found["depth_l1_m"] = views["l1_all_m"]
    for depth in list(metrics.get("held_out", {}).values())[:1]:  # gt where there is one, else the first sensor
        found |= {"held_out_l1_m": depth["l1_m"], "held_out_median_m": depth["median_m"]}
        found |= {"held_out_seen": depth["completeness"], "held_out_sensor": depth["sensor"]}
    if color := metrics.get("held_out_color"):
        found["held_out_psnr_db"] = color["psnr_db"]
    return found | {"uncertainty": {s: {n: u[n] for n in UNCERTAINTY} for s, u in metrics["uncertainty"].items()}}


def trajectory_scores(metrics: Record) -> Record:
    """Errors of the camera of a tracked run, and the share of its frames that have a pose."""
    found = metrics.get("trajectory")
    if not found:
        return {}
    return {
        "ate_m": found["ate_m"]["rmse"],
        "ate_aligned_m": found["ate_aligned_m"]["rmse"],
        "posed": found.get("completeness"),
    }
