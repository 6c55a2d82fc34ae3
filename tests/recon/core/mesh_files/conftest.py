"""A box of 4 x 3 x 2.5 m, area 59 m2, and the reader under test."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from uncle.recon.core.mesh import Mesh, PointCloud, load_surface

CORNERS = [(x, y, z) for x in (0.0, 4.0) for y in (0.0, 3.0) for z in (0.0, 2.5)]
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
TRIANGLES = [triangle for a, b, c, d in QUADS for triangle in ((a, b, c), (a, c, d))]
BOX_AREA = 59.0


def area(mesh: Mesh) -> float:
    a, b, c = mesh.vertices.astype(float)[mesh.faces].transpose(1, 0, 2)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


@dataclass(frozen=True)
class Read:
    surface: Mesh | PointCloud
    notes: list[str]

    @property
    def area(self) -> float:
        return area(self.surface)


@pytest.fixture
def read(tmp_path: Path):
    """Write text or bytes to a file and read it back: name, content -> surface and notes."""

    def write_and_read(name: str, content: str | bytes) -> Read:
        path = tmp_path / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        notes: list[str] = []
        surface = load_surface(path, lambda event: notes.append(event.text))
        return Read(surface, notes)

    return write_and_read
