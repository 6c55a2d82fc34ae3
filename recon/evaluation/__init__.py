"""Scores against ground truth. Never read by a method."""
