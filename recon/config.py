"""Settings of the map: small frozen models, presets by method name, and `key=value` overrides."""

from __future__ import annotations

import difflib
import tomllib
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from .errors import ConfigError


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class FusionConfig(_Strict):
    """Closed-form fusion of depth images."""

    voxel_size_m: float = Field(0.02, gt=0.001, le=0.5)
    truncation_voxels: float = Field(4.0, ge=2.0, le=16.0)
    max_depth_m: float = Field(6.0, gt=0.1, le=1000.0)
    blur_voxels: float = Field(0.25, ge=0)  # what the grid itself cannot resolve, added to beta in the weights
    min_readings: float = Field(3.0, ge=1.0)  # a sample seen less often is not part of the surface
    sweeps: int = Field(2, ge=0)  # fusions of all frames after the first one, each with what was learned before it


class UncertaintyConfig(_Strict):
    """The network h_w of each sensor (paper section on uncertainty; METHOD.md section 3 gives the original)."""

    enabled: bool = True  # False: every reading weighs the same
    hidden: int = Field(32, ge=4)
    beta_min_m: float = Field(1e-3, gt=0)  # paper: 1e-3
    learning_rate: float = Field(3e-3, gt=0)
    steps_per_keyframe: int = Field(10, ge=0)
    steps_per_sweep: int = Field(400, ge=0)
    batch: int = Field(4096, ge=16)


class KeyframeConfig(_Strict):
    """Which frames lend their pixels to the learning."""

    max_overlap: float = Field(0.9, gt=0, le=1.0)  # a frame is a keyframe if no earlier one sees more of it than this
    rays: int = Field(3000, ge=100)  # pixels drawn from a keyframe
    max_rays: int = Field(400_000, ge=1000)  # pixels kept in all; beyond it random ones make place


class FieldConfig(_Strict):
    """The neural field and its refinement by rendering."""

    iterations: int = Field(300, ge=0)
    rays: int = Field(2048, ge=64)
    samples: int = Field(8, ge=4)
    levels: tuple[Annotated[int, Field(ge=1, le=64)], ...] = (4, 12)  # cell sizes of the feature grids, in voxels
    channels: int = Field(4, ge=1)
    hidden: int = Field(24, ge=4)
    learning_rate_sdf_m: float = Field(5e-4, gt=0)
    learning_rate: float = Field(2e-3, gt=0)
    color_weight: float = Field(0.1, ge=0)
    prior_weight: float = Field(1.0, ge=0)


class MapConfig(_Strict):
    """Everything that decides the result of `uncle map`."""

    method: Literal["uncle", "tsdf"] = "uncle"
    sensors: tuple[str, ...] = ()
    seed: int = Field(0, ge=0, lt=2**63)
    device: Literal["auto", "cpu", "cuda"] = "auto"
    hold_out: int = Field(0, ge=0)  # every n-th frame is kept out of the map, to be scored by `uncle eval`; 0 = none
    fusion: FusionConfig = FusionConfig()
    uncertainty: UncertaintyConfig = UncertaintyConfig()
    keyframes: KeyframeConfig = KeyframeConfig()
    field: FieldConfig = FieldConfig()


PRESETS: dict[str, dict[str, Any]] = {
    "uncle": {},
    "tsdf": {"fusion": {"sweeps": 0}, "uncertainty": {"enabled": False}, "field": {"iterations": 0}},
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
