"""Compiled kernels: numba functions found again on disk by everything that their machine code depends on."""
