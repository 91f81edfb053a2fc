"""Run a plan: schedule its work, have it computed, and record the results."""
