"""What is read is never executed, and takes no more than it has: pickles, archives, names, HTML."""

import io
import os
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from uncle.recon.core.depth_image import read_depth_values
from uncle.recon.core.errors import DataError, UncleError, one_line
from uncle.recon.core.html import Section, explain, heading, missing, page, preformatted, table
from uncle.recon.core.tensor_files import FileFormat, load_tensors
from uncle.recon.evaluation.inspection.findings import Finding, Verdict
from uncle.recon.methods.nice.decoder_files import load_decoders
from uncle.recon.methods.pretrain.depth_pairs import DepthPairs
from uncle.recon.methods.pretrain.senfunet_scenes import load_scenes
from uncle.recon.visualization.inspection_pages import findings_table

ROOT = Path(__file__).parents[1]
SOURCES = [path for top in ("recon", "datasets", "cli") for path in sorted((ROOT / top).rglob("*.py"))]
NASTY = '<script>alert("1")</script>'
TENSOR_READERS = (
    load_tensors,
    load_decoders,
    lambda path: FileFormat("x", 1, "a file", "make it").load(path, "--file"),
)
ARRAY_READERS = (read_depth_values, DepthPairs.load, load_scenes)


class Hostile:
    """Makes a folder when it is unpickled."""

    def __init__(self, folder):
        self.folder = folder

    def __reduce__(self):
        return os.mkdir, (str(self.folder),)


@pytest.mark.parametrize("read", TENSOR_READERS)
@pytest.mark.parametrize("zipped", [True, False])
def test_tensor_files_run_no_code(tmp_path, read, zipped):
    path = tmp_path / "model.pt"
    torch.save(
        {"format": "x", "version": 1, "model": Hostile(tmp_path / "made")}, path, _use_new_zipfile_serialization=zipped
    )
    with pytest.raises(UncleError):
        read(path)
    assert not (tmp_path / "made").exists()


@pytest.mark.parametrize("suffix", [".npy", ".npz"])
def test_arrays_run_no_code(tmp_path, suffix):
    path, array = tmp_path / f"depth{suffix}", np.array([Hostile(tmp_path / "made")], dtype=object)
    np.save(path, array) if suffix == ".npy" else np.savez(path, depth=array, format=array)
    for read in ARRAY_READERS:
        with pytest.raises(DataError):
            read(path)
    assert not (tmp_path / "made").exists()


def test_no_module_reads_what_could_be_executed():
    forbidden = re.compile(
        r"\byaml\b|\bpickle\.loads?\(|allow_pickle=True|weights_only=False|\bmarshal\b|\bshelve\b|(?<![\w.])(eval|exec)\("
        r"|\bnp\.load\((?!.*allow_pickle=False)|extractall|\.extract\(|tarfile|unpack_archive|shell=True|os\.system"
    )
    found = [f"{path}: {line}" for path in SOURCES for line in path.read_text().splitlines() if forbidden.search(line)]
    own = "recon/visualization/offscreen.py"  # a process of ours reads what another wrote a moment ago; NumPy's default
    assert [line for line in found if own not in line] == []
    assert all("np.load(job /" in line for line in found)


def npy(array):
    buffer = io.BytesIO()
    np.save(buffer, array)
    return buffer.getvalue()


def test_archives_write_nothing_outside(tmp_path):
    folder = tmp_path / "data"
    folder.mkdir()
    with zipfile.ZipFile(folder / "depth.npz", "w") as archive:
        archive.writestr("depth.npy", npy(np.ones((4, 4), np.float32)))
        archive.writestr("../../outside.npy", npy(np.ones(3)))
    assert read_depth_values(folder / "depth.npz").shape == (4, 4)
    for read in ARRAY_READERS[1:]:
        with pytest.raises(DataError):
            read(folder / "depth.npz")
    assert [path.name for path in sorted(tmp_path.rglob("*"))] == ["data", "depth.npz"]


def claim(shape):
    """A NPY file of no more than its header."""
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode()


@pytest.mark.parametrize("shape", ["(1000000, 1000000)", "(-1, 4)", "(4, 4)"])
def test_headers_reserve_no_memory(tmp_path, shape):
    (tmp_path / "depth.npy").write_bytes(claim(shape))
    with zipfile.ZipFile(tmp_path / "depth.npz", "w") as archive:
        archive.writestr("depth.npy", claim(shape))
        archive.writestr("format.npy", claim(shape))
    with pytest.raises(DataError, match=r"names .* bytes"):
        read_depth_values(tmp_path / "depth.npy")
    for read in ARRAY_READERS:
        with pytest.raises(DataError):
            read(tmp_path / "depth.npz")


def test_archives_unpack_within_bounds(tmp_path):
    path = tmp_path / "depth.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("depth.npy", claim("(4, 4)"))
    data = path.read_bytes()
    size = len(claim("(4, 4)")).to_bytes(4, "little")
    path.write_bytes(data.replace(size, (0xFFFFFFF0).to_bytes(4, "little")))  # what it would have when unpacked
    for read in ARRAY_READERS:
        with pytest.raises(DataError, match=r"bytes|not a whole"):
            read(path)


def test_tensors_that_repeat_a_few_values_are_refused(tmp_path):
    path = tmp_path / "model.pt"
    torch.save({"weights": torch.zeros(1).expand(1 << 40)}, path)
    with pytest.raises(UncleError, match="damaged"):
        load_tensors(path)


def test_packed_tensor_files_are_refused(tmp_path):
    torch.save({"weights": torch.zeros(1 << 16)}, tmp_path / "plain.pt")
    with zipfile.ZipFile(tmp_path / "plain.pt") as plain, zipfile.ZipFile(tmp_path / "packed.pt", "w", 8) as packed:
        for entry in plain.infolist():
            packed.writestr(entry.filename, plain.read(entry))
    assert load_tensors(tmp_path / "plain.pt")["weights"].shape == (1 << 16,)
    with pytest.raises(UncleError, match="damaged"):
        load_tensors(tmp_path / "packed.pt")


def test_pages_escape_all_that_they_show():
    finding = Finding(NASTY, Verdict.WRONG, 1.0, NASTY, NASTY, NASTY)
    parts = [explain(NASTY), heading(NASTY), missing(f"`{NASTY}`"), preformatted(NASTY), findings_table([finding])]
    parts.append(table((NASTY,), [(NASTY,), (NASTY, NASTY)]))
    text = page(NASTY, NASTY, [Section(NASTY, "".join(parts))])
    assert "<script" not in text
    assert text.count("&lt;script&gt;") >= 12


def test_messages_show_control_characters_as_escapes():
    assert str(DataError("a\nb\x1b[31m\udc80é")) == r"a\nb\x1b[31m\udc80é"
    assert one_line("plain é") == "plain é"
