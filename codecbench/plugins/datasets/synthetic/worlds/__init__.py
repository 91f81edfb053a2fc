"""Named synthetic scenes: a place, a path through it, and conditions of increasing severity."""
