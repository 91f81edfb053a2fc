"""What a run is to compute next, from what it has found: the trials of searches, and repeats that decide something."""
