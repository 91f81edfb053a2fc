"""From records to numbers: curves, limits, rankings, choices and comparisons, as dataclasses and tables."""
