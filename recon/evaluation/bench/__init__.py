"""Repeating the whole chain over methods, sensors and seeds: planning, running, statistics and tables.

Nothing here reconstructs or scores: every pass is the program itself, as processes of their own.
"""
