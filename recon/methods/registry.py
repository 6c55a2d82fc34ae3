"""Every method of `uncle map`: those of this package, and those that installed packages add (docs/python.md).

Importing this module is cheap: an implementation is imported when its method runs.
"""

from __future__ import annotations

from functools import cache

from ..core.config.presets import PRESETS, add_preset, remove_preset
from ..core.errors import ConfigError
from ..core.plugins import load_plugins
from .spec import MethodSpec

ENTRY_POINTS = "uncle.methods"
DEFAULT_METHOD = "uncle"

_DEPTH_ONLY = {"depth": ("nice.color=false",)}  # the paper's depth-only rows use no colour in the map either

# In the order of help texts and tables.
BUILT_IN = (
    MethodSpec(
        name="uncle",
        summary="closed-form fusion with learned uncertainty, photometric depth and refinement by rendering",
        kind="full",
        implementation=".uncle.method:run",
        preset=PRESETS["uncle"],
    ),
    MethodSpec(
        name="uncle-paper",
        summary="feature grids optimised by rendering, depth weighted by learned uncertainty, as in UncLe-SLAM",
        kind="online",
        implementation=".nice.system:NiceSystem",
        preset=PRESETS["uncle-paper"],
        trained_parts=".nice.trained:digests",
        bench_settings=_DEPTH_ONLY,
    ),
    MethodSpec(
        name="nice-slam",
        summary="the same feature grids without weights, as in NICE-SLAM",
        kind="online",
        implementation=".nice.system:NiceSystem",
        preset=PRESETS["nice-slam"],
        trained_parts=".nice.trained:digests",
        bench_settings=_DEPTH_ONLY,
    ),
    MethodSpec(
        name="nice-slam-pre",
        summary="the same feature grids, weighted by confidences of pretrained networks",
        kind="online",
        implementation=".nice.system:NiceSystem",
        preset=PRESETS["nice-slam-pre"],
        trained_parts=".nice.trained:digests",
        bench_settings=_DEPTH_ONLY,
    ),
    MethodSpec(
        name="vox-fusion",
        summary="signed distances on sparse voxels, tracked and mapped by rendering, as in Vox-Fusion",
        kind="online",
        implementation=".vox.system:VoxSystem",
        preset=PRESETS["vox-fusion"],
    ),
    MethodSpec(
        name="senfunet",
        summary="one or two sensors fused by trained networks, as in SenFuNet",
        kind="batch",
        implementation=".senfunet.method:fuse",
        preset=PRESETS["senfunet"],
        trained_parts=".senfunet.method:trained_digests",
        max_sensors=2,
        is_deterministic=True,
        bench_given_only="it fuses with given poses and has no tracker",
    ),
    MethodSpec(
        name="tsdf",
        summary="Open3D's fusion with equal weights, the reference baseline",
        kind="batch",
        implementation=".open3d_tsdf:fuse_open3d",
        preset=PRESETS["tsdf"],
        clean_mesh=False,  # what a user of Open3D would get
        is_deterministic=True,
    ),
)

_METHODS: dict[str, MethodSpec] = {spec.name: spec for spec in BUILT_IN}


def method_specs() -> dict[str, MethodSpec]:
    """Every method by name: those of this package first, then those that were added."""
    plugin_problems()
    return dict(_METHODS)


def method_spec(name: str) -> MethodSpec:
    """The method called `name`. Raises ConfigError naming the known ones."""
    specs = method_specs()
    if name not in specs:
        raise ConfigError(f"unknown method {name!r}; known methods: {', '.join(specs)}")
    return specs[name]


def register_method(spec: MethodSpec) -> None:
    """Add a method for the rest of this process. Raises ConfigError if its name is taken."""
    if spec.name in _METHODS:
        raise ConfigError(f"there is a method called {spec.name!r} already; choose another name")
    add_preset(spec.name, spec.preset, spec.settings)
    _METHODS[spec.name] = spec


def unregister_method(name: str) -> None:
    """Remove a method that `register_method` added. Raises ConfigError for any other."""
    if name not in _METHODS or name in {spec.name for spec in BUILT_IN}:
        raise ConfigError(f"{name!r} is not a method that was added")
    del _METHODS[name]
    remove_preset(name)


@cache
def plugin_problems() -> tuple[str, ...]:
    """Adds the methods of installed packages, once; one line for each that had to be skipped."""
    return tuple(load_plugins(ENTRY_POINTS, MethodSpec, register_method))
