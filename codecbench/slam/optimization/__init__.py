"""Least squares: a pose, a bundle of poses and points, a graph of similarities."""
