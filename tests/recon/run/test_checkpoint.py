"""States on disk: exact, whole or absent, of the same settings only."""

import resource
import signal
from pathlib import Path

import pytest
import torch
from uncle.recon.core.errors import DataError, RunError
from uncle.recon.core.tensor_files import load_tensors, save_tensors, taking_apart
from uncle.recon.run.checkpoint import VERSION, Checkpoint


def test_round_trip_is_exact(tmp_path):
    generator = torch.Generator().manual_seed(3)
    state = {"a": torch.randn(5, 3, generator=generator), "b": [1, "x", {"c": torch.arange(3)}]}
    state["generator"] = generator.get_state()
    save_tensors(tmp_path / "deep" / "state.pt", state)
    found = load_tensors(tmp_path / "deep" / "state.pt")
    assert torch.equal(found["a"], state["a"])
    assert found["b"][:2] == [1, "x"]
    assert torch.equal(found["generator"], state["generator"])
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["state.pt"]


def test_only_the_same_settings_continue(tmp_path):
    path = tmp_path / "checkpoint.pt"
    assert Checkpoint(path, "one").load() is None
    Checkpoint(path, "one").save({"x": 1})
    assert Checkpoint(path, "one").load()["x"] == 1
    assert Checkpoint(path, "two").load() is None
    Checkpoint(path, "one").remove()
    Checkpoint(path, "one").remove()
    assert not path.exists()


def test_states_of_another_version_are_not_continued(tmp_path, monkeypatch):
    kept = Checkpoint(tmp_path / "checkpoint.pt", "one")
    kept.save({"x": 1})
    monkeypatch.setattr("uncle.recon.run.checkpoint.VERSION", VERSION + 1)
    assert kept.load() is None
    save_tensors(kept.path, {"config_hash": "one", "x": 1})  # from before there were versions
    assert kept.load() is None


def test_saves_are_due_by_the_clock(tmp_path):
    assert not Checkpoint(tmp_path / "a.pt", "", interval_s=1e9).due()
    checkpoint = Checkpoint(tmp_path / "a.pt", "", interval_s=0.0)
    assert checkpoint.due()
    checkpoint.interval_s = 1e9
    assert not checkpoint.due()


@pytest.mark.parametrize("content", [b"", b"nonsense", b"PK\x03\x04nonsense", b"\x80\x02c__builtin__\nprint\n."])
def test_damaged_files_are_one_line(tmp_path, content):
    path = tmp_path / "state.pt"
    path.write_bytes(content)
    with pytest.raises(RunError, match="damaged") as caught:
        load_tensors(path)
    assert "\n" not in str(caught.value)
    assert "overwrite" in str(caught.value)


def test_changed_values_are_noticed(tmp_path):
    path = tmp_path / "state.pt"
    values = torch.arange(100.0)
    save_tensors(path, {"values": values})
    content = path.read_bytes()
    assert values.numpy().tobytes() in content
    path.write_bytes(content.replace(values.numpy().tobytes(), (values + 1).numpy().tobytes()))
    with pytest.raises(RunError, match="damaged"):
        load_tensors(path)


def test_content_that_does_not_fit_is_damage(tmp_path):
    with pytest.raises(RunError, match=r"state.pt: it is damaged"), taking_apart(tmp_path / "state.pt"):
        {}["frames"]
    with pytest.raises(DataError, match="kept"), taking_apart(tmp_path / "state.pt"):
        raise DataError("kept")
    with pytest.raises(torch.OutOfMemoryError), taking_apart(tmp_path / "state.pt"):
        raise torch.OutOfMemoryError


def test_missing_file_names_the_command(tmp_path):
    with pytest.raises(RunError, match="uncle map"):
        load_tensors(tmp_path / "none.pt")


@pytest.fixture
def small_files():
    """No file of this process may grow beyond 100 kB, as on a disk that fills up."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, limits[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    signal.signal(signal.SIGXFSZ, handler)


@pytest.mark.parametrize("numbers", [24_000, 25_100, 1_000_000])
def test_a_write_that_fails_is_explained_and_keeps_the_old_state(tmp_path, small_files, numbers):
    path = tmp_path / "state.pt"
    save_tensors(path, {"old": 1})
    if numbers == 24_000:  # just fits
        save_tensors(path, {"new": torch.zeros(numbers)})
        return
    with pytest.raises(RunError, match="cannot write"):
        save_tensors(path, {"new": torch.zeros(numbers)})
    assert load_tensors(path) == {"old": 1}
    assert [entry.name for entry in tmp_path.iterdir()] == ["state.pt"]


def test_full_disk_is_named(tmp_path, monkeypatch):
    """A device that is always full, in place of the temporary file."""
    full = Path("/dev/full")
    if not full.exists():
        pytest.skip("this system has no /dev/full")
    monkeypatch.setattr("builtins.open", lambda *_, original=open, **__: original(full, "wb"))
    with pytest.raises(RunError, match="disk is full"):
        save_tensors(tmp_path / "state.pt", {"a": torch.zeros(100_000)})
