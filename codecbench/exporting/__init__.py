"""Writes results of a run as files of other programs: evo, Foxglove, Rerun."""
