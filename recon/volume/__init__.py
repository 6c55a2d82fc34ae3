"""The map: truncated signed distances on a sparse voxel grid, and the field made of them."""
