"""Loops around a run that add cells: searches, repeats until something is decided, cells that wait for others."""
