"""Evaluators whose modules do not import, because of what they declare."""
