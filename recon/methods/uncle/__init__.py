"""The default method. Start at pipeline.py."""
