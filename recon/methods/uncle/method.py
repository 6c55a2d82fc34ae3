"""The default method as the registry runs it: reconstruct, then write files and facts of the run."""

from __future__ import annotations

from typing import Any

from ...sensors.noise_prior import save_noise_models
from ..base import MapJob, MapResult, require_surface, rounded_seconds
from ..map_output import MapOutput
from .pipeline import reconstruct


def run(job: MapJob) -> MapResult:
    """Make the map of `job`; write beta maps, curves, faults and noise models. Raises DataError without a surface."""
    output, config = MapOutput(job.run), job.config
    made = reconstruct(
        job.frames, job.indices, config, job.checkpoint, output.write_beta, job.on_event, job.prior
    )  # fmt: skip
    require_surface(made.field)
    output.drop_earlier_map()
    output.write_curves(made.curves)
    facts: dict[str, Any] = {
        "seconds": rounded_seconds(made.seconds),
        "keyframes": len(made.mapper.selector.T_camera_world),
    }
    facts["bias_test_improved_ratio"] = {
        sensor: round(share, 4) for sensor, share in made.mapper.bias.confirmed.items()
    }
    facts["bias_corrected_sensors"] = sorted(made.mapper.bias.believed())
    facts["sensor_reliability"] = {sensor: round(worth, 4) for sensor, worth in made.mapper.weights.worth.items()}
    facts["error_quantiles_in_beta"] = {sensor: widths for sensor, widths in made.mapper.intervals.items() if widths}
    facts["sensor_weight_share"] = {sensor: round(share, 4) for sensor, share in made.mapper.weight_share().items()}
    facts |= output.write_faults(made.mapper.health, job.on_event)
    if config.uncertainty.enabled:
        save_noise_models(job.run.noise_model_path, made.mapper.noise)
    return MapResult(made.field, made.poses, made.tracking, facts)
