"""The maps of a run: which of them is tracked in, where a lost camera is sought, and what becomes of each."""
