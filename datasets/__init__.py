"""Readers of recorded sequences: each turns files on disk into `Frame` values. registry.py lists them."""

from .registry import ReaderSpec, open_dataset, reader_specs, recognise, register_reader

__all__ = ["ReaderSpec", "open_dataset", "reader_specs", "recognise", "register_reader"]
