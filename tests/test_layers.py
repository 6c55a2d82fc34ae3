"""The rooms of the program and what each may import; see docs/architecture.md."""

from __future__ import annotations

import ast
import subprocess
import sys
import tomllib
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TOP = ("recon", "cli", "datasets")
SENSORS = {"core", "run", "volume", "sensors"}
METHODS = {*SENSORS, "mvs", "tracking"}
EVALUATION = {"core", "run", "sensors"}
# room of recon -> the rooms that it may import
ROOMS = {
    "core": set(),
    "run": {"core"},
    "volume": {"core"},
    "sensors": {"core", "run", "volume"},
    "mvs": SENSORS,
    "tracking": SENSORS,
    "methods": METHODS,
    "evaluation": EVALUATION,
    "visualization": {*EVALUATION, "volume", "evaluation"},
    "stages": {*METHODS, "methods", "evaluation", "visualization"},
}
# what cli may import of recon beside core and stages
CLI = {
    "recon.run.directory", "recon.run.frames", "recon.methods.registry", "recon.methods.pretrain",
    "recon.methods.confidence.models", "recon.sensors.noise_prior", "recon.evaluation", "recon.visualization",
}  # fmt: skip
METHOD_FOLDERS = ("uncle", "nice", "vox", "senfunet")
FILES = {path.relative_to(ROOT): path for top in TOP for path in sorted((ROOT / top).rglob("*.py"))}


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(FILES[path].read_text())


def module_of(path: Path) -> str:
    """recon/core/files.py -> recon.core.files"""
    parts = path.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_of(path): path for path in FILES}


@cache
def imports(path: Path) -> frozenset[str]:
    """Modules of this program that a file imports, anywhere in it: also late, and for type checking alone."""
    package = list(path.parent.parts)
    found = set()
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            found |= {alias.name.removeprefix("uncle.") for alias in node.names if alias.name.startswith("uncle.")}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            name = ".".join([*base, *(node.module or "").split(".")]).strip(".").removeprefix("uncle.")
            if name.split(".")[0] in TOP:
                inner = {f"{name}.{alias.name}" for alias in node.names} & set(MODULES)
                found |= inner or {name}
    return frozenset(found - {module_of(path)})


def room(module: str) -> str:
    """recon.core.files -> core; cli.map -> cli"""
    top, *rest = module.split(".")
    return rest[0] if top == "recon" and rest else top


def one_of_each(paths):
    return pytest.mark.parametrize("path", list(paths), ids=str)


def test_the_check_sees_imports():
    assert "recon.stages.preprocess" in imports(Path("cli/preprocess.py"))
    assert "recon.core.errors" in imports(Path("recon/core/files.py"))


def test_recon_holds_the_ten_rooms():
    folders = {p.name for p in (ROOT / "recon").iterdir() if p.is_dir() and p.name != "__pycache__"}
    files = {p.name for p in (ROOT / "recon").iterdir() if p.is_file()}
    assert folders == set(ROOMS)
    assert files <= {"__init__.py", "py.typed"}


@one_of_each(FILES)
def test_imports_follow_the_rooms(path):
    mine = room(module_of(path))
    for module in imports(path):
        theirs = room(module)
        if mine == theirs or module in TOP:
            continue
        if path.parts[0] == "datasets":
            assert theirs == "core", f"{path} imports {module}"
        elif path.parts[0] == "cli":
            allowed = theirs in {"core", "stages", "datasets"} or any(
                module == name or module.startswith(f"{name}.") for name in CLI
            )
            assert allowed, f"{path} imports {module}"
        else:
            assert theirs in ROOMS[mine], f"{path} imports {module}"


@one_of_each(path for path in FILES if path.parts[:2] == ("recon", "methods") and path.parts[2] in METHOD_FOLDERS)
def test_methods_do_not_import_each_other(path):
    others = {f"recon.methods.{name}" for name in METHOD_FOLDERS if name != path.parts[2]}
    assert not [module for module in imports(path) if module.startswith(tuple(others))]


@one_of_each(path for path in FILES if path.parts[:3] == ("recon", "evaluation", "bench"))
def test_bench_runs_processes_only(path):
    for module in imports(path):
        assert module.startswith(("recon.core", "recon.evaluation.bench")), f"{path} imports {module}"


def ring(graph: dict[str, set[str]]) -> list[str]:
    """The nodes of a circle in the graph, or nothing."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return error.args[1]
    return []


def test_no_circle_of_files():
    assert ring({module_of(path): set(imports(path)) for path in FILES}) == []


def test_no_circle_of_rooms():
    graph: dict[str, set[str]] = {}
    for path in FILES:
        mine = room(module_of(path))
        graph.setdefault(mine, set()).update({room(module) for module in imports(path)} - {mine})
    assert ring(graph) == []


@one_of_each(Path("recon", name, "__init__.py") for name in ROOMS)
def test_faces_define_nothing(path):
    """A docstring, names, and at most the lazy `__getattr__` that finds them."""
    body = tree_of(path).body
    assert ast.get_docstring(tree_of(path))
    assert [type(node).__name__ for node in body if isinstance(node, ast.ClassDef)] == []
    assert {node.name for node in body if isinstance(node, ast.FunctionDef)} <= {"__getattr__", "__dir__"}


@pytest.mark.parametrize("name", ROOMS)
def test_faces_load_no_heavy_library(name):
    script = f"import sys, uncle.recon.{name}; print(sorted({{'torch', 'open3d', 'matplotlib'}} & set(sys.modules)))"
    answer = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"


@one_of_each(path for path in FILES if path.parts[0] == "recon")
def test_the_library_neither_prints_nor_knows_click(path):
    tree = tree_of(path)
    calls = {node.func.id for node in ast.walk(tree) if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)}
    modules = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    modules |= {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.level == 0}
    assert "print" not in calls
    assert not {module.split(".")[0] for module in modules} & {"click", "rich", "tqdm", "evo"}


def is_private(name: str) -> bool:
    """Whether a name begins with an underscore and is none of the language's own, such as `__version__`."""
    return name.startswith("_") and not name.endswith("__")


def private_imports(paths) -> set[str]:
    """`file: name` of every name with a leading underscore that a file takes from another module of the program."""
    found = set()
    for path in paths:
        for node in ast.walk(ast.parse((ROOT / path).read_text())):
            if isinstance(node, ast.ImportFrom) and (node.level or (node.module or "").startswith("uncle.")):
                found |= {f"{path}: {a.name}" for a in node.names if is_private(a.name)}
    return found


def test_private_names_stay_in_their_module():
    assert private_imports(FILES) == set()


def test_tests_do_not_import_private_names():
    assert private_imports(path.relative_to(ROOT) for path in (ROOT / "tests").rglob("*.py")) == set()


LIBRARY_NAMES = {"_asdict", "_replace", "_exit"}  # documented, in spite of the underscore
LIBRARY_NAMES |= {"_cache"}  # of a function of numba, where recon/core/compiled.py puts a cache that may fail


def private_uses(path: Path) -> set[str]:
    """Private names that a file reads from, or patches into, objects that it does not define itself."""
    nodes = list(ast.walk(ast.parse(path.read_text())))
    attributes = [node for node in nodes if isinstance(node, ast.Attribute)]
    own = {node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    own |= {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    own |= {node.attr for node in attributes if isinstance(node.value, ast.Name) and node.value.id in {"self", "cls"}}
    used = {node.attr for node in attributes}
    for node in nodes:
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "setattr":
            used |= {name.value for name in node.args[1:2] if isinstance(name, ast.Constant)}
    own |= LIBRARY_NAMES
    return {name for name in used if isinstance(name, str) and is_private(name) and name not in own}


def test_private_names_of_other_modules_are_not_used():
    tops = (*TOP, "benchmarks", "docs", "examples", "tests")
    paths = [path for top in tops for path in sorted((ROOT / top).rglob("*.py"))]
    uses = {str(path.relative_to(ROOT)): private_uses(path) for path in paths}
    assert {file: names for file, names in uses.items() if names} == {}


def test_every_package_is_installed():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    folders = {"uncle." + module_of(path) for path in FILES if path.name == "__init__.py"}
    assert set(settings["packages"]) == folders


@one_of_each(FILES)
def test_files_hold_one_concept(path):
    assert len(FILES[path].read_text().splitlines()) <= 500
