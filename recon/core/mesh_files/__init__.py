"""Parsers and writers of mesh and point cloud files. `../mesh.py` is what other modules use.

Every parser returns a `polygons.py::Polygons`, which still has corners as they stand in the file; `reader.py` chooses
the parser, `polygons.py` checks and triangulates. Nothing is dropped without a note.
"""
