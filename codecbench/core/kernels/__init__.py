"""Compiled kernels: numba functions in a disk cache whose keys cover all that their machine code depends on."""
