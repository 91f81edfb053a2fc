"""From a plan to records: what is ready, who computes it, and what became of it."""
