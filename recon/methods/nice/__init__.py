"""UncLe-SLAM and NICE-SLAM: `uncle-paper`, `nice-slam` and `nice-slam-pre` (docs/uncle-paper.md).

Feature grids over a box are read by pretrained decoders, rendered along rays, and optimised frame by frame. Start at
system.py; weighting.py has the losses in which the three methods differ.
"""
