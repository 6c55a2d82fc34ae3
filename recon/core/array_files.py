"""Files of NumPy arrays, read without executing anything that they say, and without more memory than they hold."""

from __future__ import annotations

import io
import math
import zipfile
from pathlib import Path

import numpy as np

from .files import read_bytes, require_file

MAX_UNPACKED_BYTES = 4 << 30  # of all arrays of an archive


def read_npy(path: Path) -> np.ndarray:
    """The array of a NPY file. Raises OSError; ValueError, or another error, if it is damaged or holds objects."""
    return _parse(read_bytes(path))


def archive_sizes(path: Path) -> dict[str, int]:
    """Array -> bytes when unpacked, of a NPZ file. Raises OSError, ValueError, zipfile.BadZipFile."""
    require_file(path)
    with zipfile.ZipFile(path) as archive:
        return {entry.filename.removesuffix(".npy"): entry.file_size for entry in archive.infolist()}


def read_npz(path: Path, *names: str, max_bytes: int = MAX_UNPACKED_BYTES) -> dict[str, np.ndarray]:
    """The arrays `names` of a NPZ file, all if none is named; nothing is written anywhere.

    Raises OSError; ValueError, zipfile.BadZipFile, or another error, if it is damaged, holds objects or more than
    `max_bytes`.
    """
    sizes = archive_sizes(path)
    chosen = names or tuple(sizes)
    total = sum(sizes[name] for name in chosen)
    if total > max_bytes:
        raise ValueError(f"{total} bytes when unpacked are too many")
    with zipfile.ZipFile(path) as archive:
        entries = {entry.filename.removesuffix(".npy"): entry for entry in archive.infolist()}
        return {name: _parse(archive.read(entries[name])) for name in chosen}  # reads no more than the stated size


def _parse(data: bytes) -> np.ndarray:
    """The array of the bytes of a NPY file. NumPy itself would first reserve the memory that the header claims."""
    file = io.BytesIO(data)
    version = np.lib.format.read_magic(file)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran_order, dtype = read_header(file)
    if dtype.hasobject:
        raise ValueError("it holds Python objects, which are not loaded")
    if dtype.kind == "c":
        raise ValueError("it holds complex numbers")
    start, size = file.tell(), math.prod(shape) * dtype.itemsize
    if size > len(data) - start or min(shape, default=0) < 0:
        raise ValueError(f"its header names {size} bytes, but it has {len(data) - start}")
    values = np.frombuffer(data, dtype, math.prod(shape), start)
    return values.reshape(shape, order="F" if fortran_order else "C").copy()
