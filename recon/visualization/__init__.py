"""Pictures and tables from files of a run."""
