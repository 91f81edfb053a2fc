"""Keyframes and points, what sees what, and how points are made, projected and merged."""
