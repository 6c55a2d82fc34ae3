"""Rooms offer names without loading the modules that define them."""

import importlib
import subprocess
import sys

import pytest

FACES = (
    "core", "run", "volume", "sensors", "mvs", "tracking", "methods", "evaluation", "visualization", "stages",
)  # fmt: skip


@pytest.mark.parametrize("room", FACES)
def test_every_name_of_a_face_can_be_imported(room):
    face = importlib.import_module(f"uncle.recon.{room}")
    assert len(face.__all__) == len(set(face.__all__))
    for name in face.__all__:
        assert getattr(getattr(face, name), "__name__", name) == name


def test_any_other_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match=r"uncle\.recon\.run.*nonsense"):
        importlib.import_module("uncle.recon.run").nonsense  # noqa: B018


def test_a_module_is_loaded_at_the_first_use_of_its_name():
    script = (
        "import sys; from uncle.recon import run; before = 'uncle.recon.run.directory' in sys.modules;"
        "run.RunDirectory; print(before, 'uncle.recon.run.directory' in sys.modules, 'RunDirectory' in vars(run))"
    )
    answer = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert answer.stdout.split() == ["False", "True", "True"]
