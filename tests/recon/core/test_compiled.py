"""Loops that are compiled where nothing can be kept, and where what was kept is damaged."""

import importlib.util
import shutil

import pytest
from uncle.recon.core.compiled import compiled

SOURCE = "from uncle.recon.core.compiled import compiled\n\n\n@compiled()\ndef double(x):\n    return 2 * x\n"


@pytest.fixture
def load(tmp_path, monkeypatch):
    """Import the module of SOURCE anew, as another process would."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    (tmp_path / "loops.py").write_text(SOURCE)

    def fresh():
        spec = importlib.util.spec_from_file_location("loops", tmp_path / "loops.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module.double

    return fresh


def test_a_function_without_a_place_for_its_code_is_compiled_all_the_same():
    """As in a read-only installation with a read-only home: numba finds no place."""
    names = {}
    exec(compile("def triple(x):\n    return 3 * x\n", "<nowhere>", "exec"), names)
    assert compiled()(names["triple"])(7) == 21


def test_code_is_kept_for_the_next_process(load, tmp_path):
    assert load()(3) == 6
    assert list((tmp_path / "__pycache__").glob("loops.double*.nbc"))
    again = load()
    assert again(3) == 6
    assert sum(again.stats.cache_hits.values()) == 1


def test_damaged_code_is_compiled_again(load, tmp_path):
    assert load()(3) == 6
    for file in (tmp_path / "__pycache__").glob("loops.double*.nb*"):
        file.write_bytes(file.read_bytes()[:20])
    assert load()(4) == 8


def test_a_place_that_vanishes_is_no_error(load, tmp_path):
    double = load()
    shutil.rmtree(tmp_path / "__pycache__")
    (tmp_path / "__pycache__").touch()
    assert double(5) == 10
