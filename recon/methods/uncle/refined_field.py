"""The field that a finished map becomes: as it is fused, then refined by rendering."""

from __future__ import annotations

import torch

from ...core.config.map_config import MapConfig
from ...core.config.uncle import FieldConfig
from ...core.events import OnEvent, ignore
from ...sensors.fusion_weights import WEIGHT_SCALE_M
from ...volume.neural_field import NeuralField
from .mapper import Mapper
from .refinement import refine

SENSORS_ALONE = 0.1  # of the step size of the feature grids, where colour says nothing


def refined_field(mapper: Mapper, config: MapConfig, on_event: OnEvent = ignore) -> tuple[NeuralField, list[float]]:
    """The field, and the mean negative log-likelihood of each step of its refinement, nats."""
    generator = torch.Generator().manual_seed(config.seed)
    stated = WEIGHT_SCALE_M if config.uncertainty.enabled else None
    field = NeuralField.from_fusion(mapper.volume, config.fusion.min_readings, config.field, generator, stated)
    far_m, step_m = mapper.volume.ray_far_m, mapper.volume.ray_step_m
    readings = mapper.readings_along_rays() if config.field.iterations else []
    losses = refine(field, readings, field_settings(mapper, config.field), far_m, step_m, generator, on_event)
    return field, losses


def field_settings(mapper: Mapper, config: FieldConfig) -> FieldConfig:
    """Sensors alone repeat the errors that the fused map has, or was cured of: without colour it is to move less."""
    if mapper.witness.testimony:
        return config
    return config.model_copy(update={"learning_rate": SENSORS_ALONE * config.learning_rate})
