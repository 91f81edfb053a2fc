"""The paper compared with our measurements: its tables, its figures, its contradictions."""
