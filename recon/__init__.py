"""The reconstruction library: maps, uncertainty, meshes and scores. No Click, no data-set layouts, no printing."""
