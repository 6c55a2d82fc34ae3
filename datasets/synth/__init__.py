"""Synthetic data sets: rendered rooms with simulated depth sensors."""
