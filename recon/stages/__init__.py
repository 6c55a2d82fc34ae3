"""The seven commands as functions: check, run, record in the manifest."""
