"""Codecs in order, as far as a run can tell them apart."""
