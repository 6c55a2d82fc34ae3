"""Confidence of depth measurements from a network that was trained on true depth: the baseline `nice-slam-pre`."""
