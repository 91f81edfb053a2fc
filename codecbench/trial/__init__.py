"""From a recording to an answer in one step: open it, write a matrix for it, run and report."""
