"""Mapping: the first map, its growth around new keyframes, loop closing and map merging."""
