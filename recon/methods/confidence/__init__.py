"""Confidence of depth readings from a network that was trained on true depth: the baseline `nice-slam-pre`."""
