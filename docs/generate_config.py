"""Writes docs/config.md from the models of the settings; with `--check` it only compares. `make docs` runs it."""

import inspect
import sys
from itertools import groupby
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from uncle.recon.core.config.map_config import MapConfig, known_keys
from uncle.recon.core.config.presets import PRESETS

PAGE = Path(__file__).with_name("config.md")
HEAD = """# Settings

Generated from the models in `recon/core/config/` by `make docs`.

```sh
uncle map --set fusion.voxel_size_m=0.01 --set fusion.passes=3
uncle map --set "field.levels=[4, 8, 16]"
```

`--set KEY=VALUE` may be given several times and wins over the method's preset; values are written as in TOML. An
unknown key or a value out of range is refused before anything is computed. The run's `config.toml` records them all.
"""
BOUNDS = {"gt": "> {}", "ge": "≥ {}", "lt": "< {}", "le": "≤ {}"}


def render() -> str:
    """The page."""
    sections = [HEAD]
    for group, keys in groupby(known_keys(), key=lambda key: key.rpartition(".")[0]):
        title = f"## `{group}`" if group else "## The map as a whole"
        rows = [_row(key) for key in keys]
        head = "| key | default | allowed | meaning |\n|---|---|---|---|"
        sections.append("\n".join([title, "", inspect.getdoc(_model(group)) or "", "", head, *rows]) + "\n")
    return "\n".join([*sections, _presets()])


def _model(group: str) -> type[BaseModel]:
    model: type[BaseModel] = MapConfig
    for name in filter(None, group.split(".")):
        model = type(model.model_fields[name].default)
    return model


def _row(key: str) -> str:
    group, _, name = key.rpartition(".")
    info = _model(group).model_fields[name]
    allowed = ", ".join(PRESETS) if key == "method" else _allowed(info)
    return f"| `{key}` | {_value(info.default)} | {allowed} | {info.description or ''} |"


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return str(list(value))
    return str(value)


def _allowed(info: FieldInfo) -> str:
    if get_origin(info.annotation) is Literal:
        return ", ".join(map(str, get_args(info.annotation)))
    if info.annotation is bool:
        return "true, false"
    limits = {name: getattr(bound, name) for bound in info.metadata for name in BOUNDS if hasattr(bound, name)}
    return ", ".join(BOUNDS[name].format(_limit(limit)) for name, limit in limits.items())


def _limit(limit: float) -> str:
    return "2^63" if limit == 2**63 else f"{limit:g}"


def _presets() -> str:
    lines = ["## Presets", "", "What `--method` changes.", "", "| method | settings |", "|---|---|"]
    for method, groups in PRESETS.items():
        values = {f"{group}.{name}": value for group, table in groups.items() for name, value in table.items()}
        changes = [f"`{key}={_value(value)}`" for key, value in values.items()]
        lines.append(f"| `{method}` | {', '.join(changes) or 'the defaults above'} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    if "--check" in sys.argv[1:]:
        sys.exit(0 if PAGE.read_text() == render() else "docs/config.md is out of date; run `make docs`")
    PAGE.write_text(render())
