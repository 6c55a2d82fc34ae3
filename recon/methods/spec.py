"""`MethodSpec`: everything that the program knows about one method of `uncle map`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from ..core.config.base import Strict
from ..core.config.map_config import MapConfig, make_config
from ..core.config.presets import Preset
from ..core.errors import ConfigError
from ..core.plugins import import_object

Kind = Literal["full", "online", "batch"]


@dataclass(frozen=True)
class MethodSpec:
    """A method: its name, its settings, how it is run and what it needs.

    name                 as in `uncle map --method NAME`
    summary              one line for the help of `uncle map`
    kind                 how `implementation` is called (see `runners.py`):
                         "batch"    function (frames, indices, config, on_event, poses) -> (NeuralField, poses)
                         "online"   class (frames, config, device) that implements `online.OnlineSystem`
                         "full"     function (MapJob) -> MapResult, which tracks, maps and writes by itself
    implementation       the function or class, or "module:name", imported when the method runs
    preset               settings that differ from the defaults, by group: {"fusion": {"passes": 0}}
    settings             model of the method's own settings `plugin.KEY`, for methods of other packages
    trained_parts        function (MapConfig) -> digests of the trained networks in use, or "module:name"; the digests
                         become part of the hash that decides whether a map is up to date
    max_sensors          the method fuses at most so many sensors; None: any number
    clean_mesh           whether `uncle mesh` removes small and unseen parts of the surface by default
    is_deterministic     with given poses nothing is drawn at random: the benchmark runs one seed
    bench_given_only     why the benchmark runs the method with given poses only; "": it can track, too
    bench_settings       additional settings (KEY=VALUE) by setting of the benchmark ("given", "depth" or "rgbd")
    """

    name: str
    summary: str
    kind: Kind
    implementation: str | Callable[..., Any]
    preset: Preset = field(default_factory=dict)
    settings: type[Strict] | None = None
    trained_parts: str | Callable[[MapConfig], list[str]] | None = None
    max_sensors: int | None = None
    clean_mesh: bool = True
    is_deterministic: bool = False
    bench_given_only: str = ""
    bench_settings: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def load(self) -> Callable[..., Any]:
        """The implementation, imported now."""
        return _loaded(self.implementation)

    def configure(self, overrides: list[str] | None = None, **top_level: Any) -> MapConfig:
        """Settings of the method: its preset, `top_level` values, then `KEY=VALUE` overrides. Raises ConfigError."""
        return make_config(self.name, overrides or [], **top_level)

    def check_sensors(self, sensors: tuple[str, ...]) -> None:
        """Raises ConfigError if the method cannot fuse so many sensors."""
        if self.max_sensors is not None and len(sensors) > self.max_sensors:
            raise ConfigError(
                f"{self.name} fuses at most {self.max_sensors} sensors, not {', '.join(sensors)}; choose with "
                f"--sensors {' '.join(sensors[: self.max_sensors])}"
            )

    def trained_digests(self, config: MapConfig) -> list[str]:
        """Digests of the trained networks that `config` uses. Raises ConfigError if a file is missing or unfit."""
        return [] if self.trained_parts is None else list(_loaded(self.trained_parts)(config))


def _loaded(reference: str | Callable[..., Any]) -> Callable[..., Any]:
    if isinstance(reference, str):
        loaded: Callable[..., Any] = import_object(reference, __package__ or "")
        return loaded
    return reference
