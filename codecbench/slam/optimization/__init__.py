"""Least squares: frame pose, bundle adjustment, pose graph of similarities."""
