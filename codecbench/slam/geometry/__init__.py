"""Cameras, rotations, rigid motions, similarities, two-view geometry and linear systems."""
