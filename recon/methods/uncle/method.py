"""The default method as the registry runs it: reconstruct, then write files and facts of the run."""

from __future__ import annotations

from ...sensors.noise_prior import save_noise_models
from ..base import MapJob, MapResult, require_surface, rounded_seconds
from ..map_output import MapOutput
from .pipeline import reconstruct


def run(job: MapJob) -> MapResult:
    """Make the map of `job`; write beta maps, curves, faults and noise models. Raises DataError without a surface."""
    output = MapOutput(job.run)
    result = reconstruct(
        job.frames, job.indices, job.config, job.checkpoint, output.write_beta, job.on_event, job.prior
    )  # fmt: skip
    require_surface(result.field)
    output.drop_earlier_map()
    output.write_curves(result.curves)
    facts = {"seconds": rounded_seconds(result.seconds), **result.facts()}
    facts |= output.write_faults(result.state.faults, job.on_event)
    if job.config.uncertainty.enabled:
        save_noise_models(job.run.noise_model_path, result.state.noise.models)
    return MapResult(result.field, result.poses, result.tracking, facts)
