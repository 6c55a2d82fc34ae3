"""Everything that reads or writes the layout of a run directory."""
