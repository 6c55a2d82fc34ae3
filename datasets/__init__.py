"""Readers of recorded sequences: each turns files on disk into `Frame` values."""
