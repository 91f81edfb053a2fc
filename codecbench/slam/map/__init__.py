"""The map: keyframes, map points and observations; triangulation, projection and fusion of points."""
