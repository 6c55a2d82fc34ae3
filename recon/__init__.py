"""The reconstruction library: maps, uncertainty, meshes and their scores. No Click, no data-set layouts, no printing."""
