"""Place recognition: which keyframes look alike, by a vocabulary tree and an inverted index."""
