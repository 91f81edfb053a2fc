"""What the paper's tables state, cell by cell.

Source: O. M. Salih and J. Vasarhelyi, "End-to-End Multi-Level Encoding Methods of Visual Data Compression for
Robust Monocular Visual ORB-SLAM", Tables 1-6. Sizes are KiB, times seconds on the authors' machine, CR is
1 - size / PNG size in percent. Frames 1132 and 2398 of TUM freiburg3_long_office_household.
"""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import Final

import pandas as pd

CITATION: Final = (
    "O. M. Salih and J. Vásárhelyi, *End-to-End Multi-Level Encoding Methods of Visual Data Compression for Robust "
    "Monocular Visual ORB-SLAM*"
)

RAW_RMSE: Final = 0.22114
"""Figure 7, no unit given; the only sensible reading is meters, both trajectories in the first frame's coordinates."""

SUCCEEDS_UP_TO: Final = {"jpeg_qf": ("qf", 15.0), "jpeg2000": ("cr_percent", 97.0), "multilevel": ("qf", 75.0)}
"""The hardest setting at which the paper's trajectory holds, by our codec's name."""


@cache
def table(name: str) -> pd.DataFrame:
    """One of `table1_jpeg`, `table2_jpeg2000`, `table3_multilevel`, `table456_operations`."""
    with (files(__package__) / f"{name}.csv").open("r") as stream:
        return pd.read_csv(stream)
