"""Comparing two runs of the same cells, such as before and after a change to a codec."""
