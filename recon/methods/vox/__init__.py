"""Vox-Fusion: an implicit distance field on sparse voxels, tracked and mapped by rendering."""
