"""The direction of the imports: cli -> recon <- datasets."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LAYERS = ("recon", "cli", "datasets")
ALLOWED = {"recon": set(), "datasets": {"recon"}, "cli": {"recon", "datasets"}}
FILES = [path for layer in LAYERS for path in sorted((ROOT / layer).rglob("*.py"))]


def imported_layers(path: Path) -> set[str]:
    """Other layers that the file imports, anywhere in it."""
    depth = len(path.relative_to(ROOT).parts)  # `from ` + this many dots reaches the folder that holds the layers
    names = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names += [alias.name.removeprefix("uncle.") for alias in node.names if alias.name.startswith("uncle.")]
        elif isinstance(node, ast.ImportFrom):
            module = node.module or ""
            if node.level == depth:
                names += [module] if module else [alias.name for alias in node.names]
            elif node.level == 0 and module.split(".")[0] == "uncle":
                names += [module.removeprefix("uncle.")]
    return {name.split(".")[0] for name in names} - {path.relative_to(ROOT).parts[0]}


def test_the_check_sees_an_import():
    assert imported_layers(ROOT / "cli" / "preprocess.py") == {"recon", "datasets"}


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_follow_the_layers(path):
    layer = path.relative_to(ROOT).parts[0]
    assert imported_layers(path) <= ALLOWED[layer]


@pytest.mark.parametrize("path", [path for path in FILES if path.is_relative_to(ROOT / "recon")], ids=lambda p: p.name)
def test_the_library_neither_prints_nor_knows_click(path):
    tree = ast.parse(path.read_text())
    calls = {node.func.id for node in ast.walk(tree) if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)}
    modules = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    modules |= {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.level == 0}
    assert "print" not in calls
    assert not {module.split(".")[0] for module in modules} & {"click", "rich", "tqdm", "evo"}


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_files_fit_on_a_few_screens(path):
    assert len(path.read_text().splitlines()) <= 300
