"""Corners, orientations, descriptors, and matches between them."""
