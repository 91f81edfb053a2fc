"""Baseline JPEG of our own, with the scalar quantisation factor of the paper."""

from codecbench.plugins.codecs.jpeg_qf.codec import JpegQf, JpegQfParams

__all__ = ["JpegQf", "JpegQfParams"]
