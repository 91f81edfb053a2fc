"""Reports of a run: text, tables, figures and the page."""
