"""The paper beside our measurement of it: its tables, its figures, its contradictions."""
