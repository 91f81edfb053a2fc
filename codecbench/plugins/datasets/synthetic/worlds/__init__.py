"""Named worlds: a place, a path through it, and conditions that hurt more and more."""
