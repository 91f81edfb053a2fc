"""Whether a run comes out the same here: some of its cells are computed again and compared."""
