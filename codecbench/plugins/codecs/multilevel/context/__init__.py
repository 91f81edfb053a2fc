"""The profile `context`: quantised coefficients coded as binary decisions with adaptive, mixed contexts.

All arithmetic is on integers, so that a bitstream is decoded to the same pixels by any machine and any compiler.
"""
