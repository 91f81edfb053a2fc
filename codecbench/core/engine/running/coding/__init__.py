"""Encoding and decoding: the only package that calls a codec for its results."""
