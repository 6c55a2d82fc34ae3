"""Plane-sweep stereo around the current surface, and what it tells about the depth sensors."""
