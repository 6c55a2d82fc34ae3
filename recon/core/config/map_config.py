"""Settings of the map: small frozen models, presets by method name, and `key=value` overrides."""

from __future__ import annotations

import difflib
import tomllib
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, ValidationError

from .confidence import ConfidenceConfig
from ..errors import ConfigError
from .nice import PRESETS as NICE_PRESETS
from .nice import NiceConfig, NiceMappingConfig, NiceTrackingConfig
from .senfunet import PRESET as SENFUNET_PRESET
from .senfunet import SenfunetConfig
from .base import Strict
from .vox import PRESET as VOX_PRESET
from .vox import VoxConfig


class FusionConfig(Strict):
    """Closed-form fusion of depth images."""

    voxel_size_m: float = Field(0.02, gt=0.001, le=0.5, description="Distance between the samples of the map, metres.")
    truncation_voxels: float = Field(
        4.0, ge=2.0, le=16.0, description="Distances are cut off at this many voxels before and behind a reading."
    )
    max_depth_m: float = Field(6.0, gt=0.1, le=1000.0, description="Readings farther than this take no part, metres.")
    blur_voxels: float = Field(
        0.5, ge=0, description="What the grid itself cannot resolve, added to beta in the weights."
    )
    min_readings: float = Field(3.0, ge=1.0, description="A sample seen less often is not part of the surface.")
    sweeps: int = Field(
        1,
        ge=0,
        description="Fusions of all frames after the first one, each with what was learned before (see `color.looks`).",
    )


class UncertaintyConfig(Strict):
    """The network h_w of each sensor: from its image to the scale beta of the error of each reading."""

    enabled: bool = Field(True, description="Learn how noisy each sensor is; false: every reading weighs the same.")
    hidden: int = Field(16, ge=4, description="Width of the two hidden layers.")
    features: tuple[str, ...] = Field(
        (), description='Inputs that the network sees, for ablations, such as ["depth", "incidence"]; empty: all.'
    )
    beta_min_m: float = Field(1e-3, gt=0, description="Smallest beta, metres (paper: 1e-3).")
    learning_rate: float = Field(
        3e-3, gt=0, description="Step size of Adam at the start of each round; it falls to a tenth."
    )
    steps_per_keyframe: int = Field(
        10, ge=0, description="Steps on the pixels of each new keyframe, before it is fused."
    )
    steps_per_sweep: int = Field(400, ge=0, description="Steps on the pixels of all keyframes after each sweep.")
    batch: int = Field(4096, ge=16, description="Pixels in each step.")


class KeyframeConfig(Strict):
    """Which frames lend their pixels to the learning."""

    max_overlap: float = Field(
        0.9, gt=0, le=1.0, description="A frame is a keyframe if no earlier one sees more of it than this share."
    )
    rays: int = Field(3000, ge=100, description="Pixels drawn from a keyframe.")
    max_rays: int = Field(400_000, ge=1000, description="Pixels kept in all; beyond it random ones make place.")


class FieldConfig(Strict):
    """The neural field and its refinement by rendering."""

    iterations: int = Field(
        200, ge=0, description="Steps of the refinement by rendering; 0: the field is the fused map."
    )
    rays: int = Field(2048, ge=64, description="Rays rendered in each step, half of them of colour where it is heard.")
    samples: int = Field(8, ge=4, description="Samples on each ray, around the present surface.")
    levels: tuple[Annotated[int, Field(ge=1, le=64)], ...] = Field(
        (4, 12), description="Cell sizes of the coarser feature grids, 1 to 64 voxels each."
    )
    channels: int = Field(4, ge=1, description="Features at each sample of those grids.")
    hidden: int = Field(24, ge=4, description="Width of the decoder's hidden layer.")
    learning_rate_sdf_m: float = Field(
        1e-4, gt=0, description="Step size of Adam for the offsets at the samples near the surface, metres."
    )
    learning_rate: float = Field(
        2.5e-3,
        gt=0,
        description="Step size of Adam for the feature grids and the decoder; a tenth of it without colour.",
    )
    color_weight: float = Field(0.1, ge=0, description="Weight of the colour error beside the likelihood of depth.")
    prior_weight: float = Field(1.0, ge=0, description="Weight of the pull back to the fused distances.")


class ColorConfig(Strict):
    """Colour as one more witness of where the surface is: depth by matching views."""

    enabled: bool = Field(
        True, description="Correct the surface by what colours of several views agree on; needs the uncertainty."
    )
    looks: int = Field(
        3,
        ge=1,
        description="Times that colour is asked, each before a sweep; once if it finds the surface where it is.",
    )
    weigh_sensors: bool = Field(
        True, description="Find what readings of each sensor are worth by predicting colour; else all a third."
    )
    max_views: int = Field(150, ge=3, description="Views whose depth is looked for, at most.")
    shift: float = Field(
        0.03, gt=0, description="A view is chosen when the camera moved by this share of the depth it sees,"
    )
    turn_rad: float = Field(0.07, gt=0, description="or turned by this angle, radians.")


class TrackingConfig(Strict):
    """Finding the camera of every frame."""

    enabled: bool = Field(
        False, description="Estimate the poses; false: take those of the recording; set by `--track`."
    )
    color: bool = Field(
        True, description="Use colour: features and photometric residuals; set by `--color` and `--no-color`."
    )
    features: int = Field(1000, ge=50, description="Features taken from an image, the strongest.")
    readings: int = Field(1000, ge=0, description="Depth readings of each sensor that are aligned with the surface.")
    explore_every: int = Field(
        3, ge=1, description="Every n-th frame, and every keyframe, enters the map while tracking; all do afterwards."
    )
    keyframe_matches: int = Field(80, ge=12, description="A frame with fewer matches becomes a keyframe.")
    keyframe_turn_rad: float = Field(0.1, gt=0, description="So does one that turned by more, radians,")
    keyframe_shift: float = Field(0.05, gt=0, description="or moved by more than this share of the depth it sees.")


class HealthConfig(Strict):
    """Noticing sensors that drop out, freeze or go wrong in the middle of a recording."""

    enabled: bool = Field(True, description="Leave out what a sensor reads while it is at fault; false: believe it.")
    min_readings: float = Field(
        0.05, ge=0, lt=1, description="A sensor is missing in a frame with at most this share of its usual readings."
    )
    max_bias: float = Field(
        0.03, gt=0, description="A median error against the map is borne, if earlier ones reach to this share of depth."
    )
    max_scatter: float = Field(0.05, gt=0, description="So is this median deviation from it, as a share of depth.")


class MapConfig(Strict):
    """Everything that decides the result of `uncle map`."""

    method: Literal["uncle", "uncle-paper", "nice-slam", "nice-slam-pre", "vox-fusion", "senfunet", "tsdf"] = Field(
        "uncle", description="The preset; set by `--method`."
    )
    sensors: tuple[str, ...] = Field(
        (), description="Sensors to use, empty: all but the ground truth; set by `--sensors`."
    )
    seed: int = Field(0, ge=0, lt=2**63, description="Seed of all randomness; set by `--seed`.")
    device: Literal["auto", "cpu", "cuda"] = Field(
        "auto", description="Where tensors live; auto takes CUDA where there is one; set by `--device`."
    )
    hold_out: int = Field(
        0, ge=0, description="Every n-th frame is kept out of the map, to be scored by `uncle eval`; 0: none."
    )
    tracking: TrackingConfig = TrackingConfig()
    health: HealthConfig = HealthConfig()
    fusion: FusionConfig = FusionConfig()
    uncertainty: UncertaintyConfig = UncertaintyConfig()
    keyframes: KeyframeConfig = KeyframeConfig()
    field: FieldConfig = FieldConfig()
    color: ColorConfig = ColorConfig()
    vox: VoxConfig = VoxConfig()
    senfunet: SenfunetConfig = SenfunetConfig()
    confidence: ConfidenceConfig = ConfidenceConfig()
    nice: NiceConfig = NiceConfig()
    nice_mapping: NiceMappingConfig = NiceMappingConfig()
    nice_tracking: NiceTrackingConfig = NiceTrackingConfig()


PRESETS: dict[str, dict[str, Any]] = {
    "uncle": {},
    **NICE_PRESETS,
    "vox-fusion": VOX_PRESET,
    "senfunet": SENFUNET_PRESET,
    "tsdf": {
        "fusion": {"sweeps": 0},
        "uncertainty": {"enabled": False},
        "color": {"enabled": False},
        "field": {"iterations": 0},
    },
}


def make_config(method: str, overrides: list[str], **top_level: Any) -> MapConfig:
    """Preset of `method`, then `top_level` settings, then `key=value` overrides such as "fusion.voxel_size_m=0.01".

    Raises ConfigError naming the closest known key, or the bound that a value breaks.
    """
    if method not in PRESETS:
        raise ConfigError(f"unknown method {method!r}; known methods: {', '.join(PRESETS)}")
    values: dict[str, Any] = {"method": method, **{k: dict(v) for k, v in PRESETS[method].items()}, **top_level}
    for override in overrides:
        _set(values, override)
    if values["method"] != method:
        raise ConfigError(f"--set method={values['method']}: a method is a preset, chosen with --method")
    try:
        return MapConfig.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        raise ConfigError(
            f"setting {'.'.join(map(str, first['loc']))}: {first['msg']} (got {first['input']!r})"
        ) from error


def known_keys(model: type[BaseModel] = MapConfig, prefix: str = "") -> dict[str, Any]:
    """Dotted name of every setting -> its default."""
    keys: dict[str, Any] = {}
    for name, info in model.model_fields.items():
        if isinstance(info.default, BaseModel):
            keys |= known_keys(type(info.default), f"{prefix}{name}.")
        else:
            keys[prefix + name] = info.default
    return keys


def to_toml(config: MapConfig) -> str:
    """The configuration as TOML text, one table per group."""
    values = config.model_dump(mode="json")
    lines = [f"{key} = {_toml_value(value)}" for key, value in values.items() if not isinstance(value, dict)]
    for key, table in values.items():
        if isinstance(table, dict):
            lines += ["", f"[{key}]", *(f"{name} = {_toml_value(value)}" for name, value in table.items())]
    return "\n".join(lines) + "\n"


def _set(values: dict[str, Any], override: str) -> None:
    key, equals, text = override.partition("=")
    key = key.strip()
    if not equals:
        raise ConfigError(f"--set {override!r}: expected key=value, for example --set fusion.voxel_size_m=0.01")
    known = known_keys()
    if key not in known:
        close = difflib.get_close_matches(key, known, n=1, cutoff=0.4)
        hint = f"; did you mean {close[0]}?" if close else f"; known keys: {', '.join(known)}"
        raise ConfigError(f"--set {override!r}: no setting is called {key!r}{hint}")
    table = values
    *groups, name = key.split(".")
    for group in groups:
        table = table.setdefault(group, {})
    table[name] = _parse(text.strip())


def _parse(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _toml_value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return "[" + ", ".join(_toml_value(item) for item in value) + "]"
    return f'"{value}"' if isinstance(value, str) else repr(value)
