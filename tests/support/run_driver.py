"""Runs a matrix in a process of its own, to be interrupted: matrix, run folder, folder of distributions."""

from __future__ import annotations

import sys
from pathlib import Path


def main() -> None:
    matrix, folder, site = map(Path, sys.argv[1:4])
    sys.path[:0] = [str(site), str(Path(__file__).parent)]
    from codecbench.core.engine.planning.matrix import read_matrix
    from codecbench.core.rounds.running import run_matrix

    summary = run_matrix(read_matrix(matrix), folder, workers=2)
    sys.exit(130 if summary.interrupted else 0)


if __name__ == "__main__":
    main()
