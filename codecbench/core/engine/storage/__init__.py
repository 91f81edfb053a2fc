"""The run folder: records, bitstreams and plans, written whole and checked when they are read."""
