"""Bundles: a run in a single file, to archive, cite and share."""
