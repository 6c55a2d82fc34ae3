"""Figures of the paper (UncLe-SLAM), to stand beside a row of the same kind; F in %, depth L1 and ATE in cm."""

from __future__ import annotations

_NICE, _PRE, _OURS = "nice-slam", "nice-slam-pre", "uncle-paper"
F, L1, ATE = "F 5 cm", "depth L1", "ATE"
Figures = dict[str, float]
Triple = tuple[float | None, float | None, float | None]


def _three(f: Triple, l1: Triple, ate: Triple = (None, None, None)) -> dict[str, Figures]:
    """Figures of NICE-SLAM, NICE-SLAM+Pre and UncLe-SLAM by method."""
    rows = zip((_NICE, _PRE, _OURS), f, l1, ate, strict=True)
    named = {method: dict(zip((F, L1, ATE), figures, strict=True)) for method, *figures in rows}
    return {method: {k: v for k, v in figures.items() if v is not None} for method, figures in named.items()}


_NO = (None, None, None)
# Replica, rendered with noisy sensors: mean of office 0, office 1 and room 2; (setting, sensors) -> method -> figures
REPLICA: dict[tuple[str, str], dict[str, Figures]] = {
    ("given", "sl"): _three((92.47, 91.98, 92.28), (1.79, 1.88, 1.85)),
    ("given", "psmnet"): _three((88.45, 88.78, 88.89), (2.64, 2.67, 2.42)),
    ("given", "sgm"): _three((90.29, 90.62, 90.40), (2.35, 2.25, 2.27)),
    ("depth", "sl"): _three((44.29, 55.32, 50.80), (16.47, 8.62, 11.48), (41.51, 26.11, 29.99)),
    ("depth", "psmnet"): _three((49.80, 54.54, 57.41), (10.65, 9.90, 7.39), (27.90, 36.95, 19.36)),
    ("depth", "sgm"): _three((48.10, 52.54, 54.72), (12.03, 18.96, 10.60), (30.73, 39.14, 29.11)),
    ("rgbd", "sl"): _three((45.96, None, 50.73), (None, None, 9.78), (36.0, None, 25.6)),
    ("rgbd", "psmnet"): _three((52.63, None, 59.09), (8.11, None, 6.49), (20.25, None, 18.92)),
    ("rgbd", "sgm"): _three((52.00, None, 58.19), (None, None, 7.79), (26.6, None, 27.4)),
    ("given", "psmnet+sgm"): _three((90.69, 90.31, 90.42), (2.03, 2.19, 1.97))
    | {"vox-fusion": {F: 35.65}, "senfunet": {F: 30.22}},
    ("given", "psmnet+sl"): _three((92.19, 92.11, 92.46), (None, None, 1.60))
    | {"vox-fusion": {F: 72.57}, "senfunet": {F: 30.85}},
    ("track", "psmnet+sgm"): _three((52.81, 63.30, 69.76), (13.58, 11.29, 4.13), (40.37, 35.55, 19.88)),
    ("track", "psmnet+sl"): _three((64.08, 70.70, 66.36), (4.70, 3.57, 3.87), (22.16, 20.43, 16.86)),
}
_SEVEN_SCENES = ("chess", "fire", "heads", "office", "pumpkin", "kitchen", "stairs")
# Sequences with depth-only tracking, mean ATE over 5 (7-Scenes, seq-01) or 10 runs (TUM)
_SEQUENCES: dict[str, dict[str, float]] = {
    scene: {_NICE: nice, _OURS: ours}
    for scene, nice, ours in zip(
        (*_SEVEN_SCENES, "freiburg1_desk", "freiburg1_desk2", "freiburg1_xyz"),
        (40.30, 47.67, 20.55, 8.49, 33.11, 24.39, 9.18, 40.40, 47.81, 5.11),
        (14.85, 25.47, 13.12, 7.83, 29.32, 6.21, 8.53, 29.04, 36.57, 2.71),
        strict=True,
    )
}
MEANING = (
    'The column "paper" repeats what the paper reports for the same kind of row: mean over runs, on Replica the mean '
    "of office 0, office 1 and room 2, with its own protocol (F-score over vertices, 1000 views). On any other data "
    "set it is a reference from another scene, not a figure to be met. The paper's two sensors with tracking stand in "
    "both tables with tracking."
)  # fmt: skip


def published(dataset: str, dataset_format: str, setting: str, sensors: str, method: str) -> str:
    """What the paper has for a row, as text; "-" if nothing. `sensors` are joined by +, in any order."""
    names = "+".join(sorted(sensors.split("+")))
    if dataset_format in ("7scenes", "tum"):
        figures = _of_sequence(dataset, setting, method)
        return f"ATE {figures:.2f}" if figures is not None else "-"
    several = "+" in names and setting != "given"
    found = REPLICA.get(("track" if several else setting, names), {}).get(method, {})
    return ("Replica: " + ", ".join(f"{name} {value:g}" for name, value in found.items())) if found else "-"


def _of_sequence(dataset: str, setting: str, method: str) -> float | None:
    name = dataset.lower().replace("-", "_")
    fits = [scene for scene in _SEQUENCES if scene in name]
    return _SEQUENCES[max(fits, key=len)].get(method) if fits and setting == "depth" else None
