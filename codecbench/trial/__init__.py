"""From a recording to an answer in one step: what lies there, a matrix that suits it, a run and its report."""
