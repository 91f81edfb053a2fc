"""Rounds of a run that add cells: searches, repeats until a decision, and cells that need the results of others."""
