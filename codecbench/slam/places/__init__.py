"""Which keyframes look alike: the vocabulary and the index over it."""
