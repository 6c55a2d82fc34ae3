"""The reconstruction library: maps, uncertainty, meshes and scores. No Click, no data-set layouts, no printing.

`__version__` is that of the installed distribution; `unknown` if there is none.
"""


def __getattr__(name: str) -> str:
    if name != "__version__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("uncle")
    except PackageNotFoundError:
        return "unknown"
