"""Damaged inputs for every parser, and what has to become of them. `../fuzz.py` is the program."""
