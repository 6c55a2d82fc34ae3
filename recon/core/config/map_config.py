"""Settings of the map: small frozen models, presets by method name, and `key=value` overrides."""

from __future__ import annotations

import difflib
import reprlib
import tomllib
from typing import Any, Literal

from pydantic import BaseModel, Field, SerializeAsAny, ValidationError, ValidationInfo, field_validator

from ..errors import ConfigError
from .base import Strict
from .confidence import ConfidenceConfig
from .nice import NiceConfig, NiceMappingConfig, NiceTrackingConfig
from .presets import PLUGIN_MODELS, PRESETS
from .senfunet import SenfunetConfig
from .uncle import (
    FaultDetectionConfig,
    FieldConfig,
    FusionConfig,
    KeyframeConfig,
    PhotometricConfig,
    TrackingConfig,
    UncertaintyConfig,
)
from .vox import VoxConfig

MAX_SHOWN = 100  # characters of an override in a message


class MapConfig(Strict):
    """Everything that decides the result of `uncle map`."""

    method: str = Field("uncle", description="The preset; set by `--method`.")
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
    fault_detection: FaultDetectionConfig = FaultDetectionConfig()
    fusion: FusionConfig = FusionConfig()
    uncertainty: UncertaintyConfig = UncertaintyConfig()
    keyframes: KeyframeConfig = KeyframeConfig()
    field: FieldConfig = FieldConfig()
    photometric: PhotometricConfig = PhotometricConfig()
    vox: VoxConfig = VoxConfig()
    senfunet: SenfunetConfig = SenfunetConfig()
    confidence: ConfidenceConfig = ConfidenceConfig()
    nice: NiceConfig = NiceConfig()
    nice_mapping: NiceMappingConfig = NiceMappingConfig()
    nice_tracking: NiceTrackingConfig = NiceTrackingConfig()
    # settings of a method of another package, of the model that it brings (MethodSpec.settings)
    plugin: SerializeAsAny[Strict] = Field(Strict(), validate_default=True)

    @field_validator("method")
    @classmethod
    def _method_is_known(cls, method: str) -> str:
        if method not in PRESETS:
            raise ValueError(f"unknown method; known methods: {', '.join(PRESETS)}")
        return method

    @field_validator("plugin", mode="before")
    @classmethod
    def _plugin_settings_have_their_model(cls, value: Any, info: ValidationInfo) -> Any:
        model = PLUGIN_MODELS.get(info.data.get("method", ""), Strict)
        return model.model_validate({} if type(value) is Strict else value)


def make_config(method: str, overrides: list[str], **top_level: Any) -> MapConfig:
    """Preset of `method`, then `top_level` settings, then `key=value` overrides such as "fusion.voxel_size_m=0.01".

    Raises ConfigError naming the closest known key, or the bound that a value breaks.
    """
    if method not in PRESETS:
        raise ConfigError(f"unknown method {method!r}; known methods: {', '.join(PRESETS)}")
    values: dict[str, Any] = {"method": method, **{k: dict(v) for k, v in PRESETS[method].items()}, **top_level}
    known = known_keys() | known_keys(PLUGIN_MODELS.get(method, Strict), "plugin.")
    for override in overrides:
        _set(values, override, known)
    if values["method"] != method:
        raise ConfigError(f"--set method={values['method']}: a method is a preset, chosen with --method")
    try:
        return MapConfig.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        raise ConfigError(
            f"setting {'.'.join(map(str, first['loc']))}: {first['msg']} (got {reprlib.repr(first['input'])})"
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
        if isinstance(table, dict) and table:
            lines += ["", f"[{key}]", *(f"{name} = {_toml_value(value)}" for name, value in table.items())]
    return "\n".join(lines) + "\n"


def _set(values: dict[str, Any], override: str, known: dict[str, Any]) -> None:
    key, equals, text = override.partition("=")
    key = key.strip()
    if not equals:
        raise ConfigError(f"--set {_shown(override)}: expected key=value, for example --set fusion.voxel_size_m=0.01")
    if key not in known:
        close = difflib.get_close_matches(key, known, n=1, cutoff=0.4)
        tables = ", ".join(dict.fromkeys(name.partition(".")[0] for name in known if "." in name))
        hint = f"; did you mean {close[0]}?" if close else f"; docs/config.md lists all, in the groups: {tables}"
        raise ConfigError(f"--set {_shown(override)}: no setting is called {_shown(key)}{hint}")
    table = values
    *groups, name = key.split(".")
    for group in groups:
        table = table.setdefault(group, {})
    table[name] = _parse(text.strip())


def _shown(text: str) -> str:
    """`text` in quotes, of a length that fits into a message."""
    return repr(text if len(text) <= MAX_SHOWN else text[:MAX_SHOWN] + "...")


def _parse(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (tomllib.TOMLDecodeError, RecursionError):
        return text


def _toml_value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return "[" + ", ".join(_toml_value(item) for item in value) + "]"
    return f'"{value}"' if isinstance(value, str) else repr(value)
