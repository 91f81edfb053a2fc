"""Cameras, rotations, rigid motions and similarities, and what two views tell of them."""
