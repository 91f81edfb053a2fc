"""The HTML report of a run: one page that loads nothing."""
