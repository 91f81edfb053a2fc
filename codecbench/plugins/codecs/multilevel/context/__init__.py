"""The profile `context`: quantized coefficients coded as binary decisions in adaptive, mixed contexts.

All arithmetic is on integers, so that a bitstream decodes to the same pixels with any machine and compiler.
"""
