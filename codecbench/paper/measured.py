"""The numbers in the paper's tables, and ours for the same settings.

Source: O. M. Salih and J. Vasarhelyi, "End-to-End Multi-Level Encoding Methods of Visual Data Compression for
Robust Monocular Visual ORB-SLAM", Tables 1-6. Sizes are KiB, times seconds on the authors' machine, CR is
1 - size / PNG size in percent. Frames 1132 and 2398 of TUM freiburg3_long_office_household.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from importlib.resources import files
from typing import Any, Final

import pandas as pd

from codecbench.core.analysis.run_result import RunResult
from codecbench.core.engine.planning.model import PluginSetting

CITATION: Final = (
    "O. M. Salih and J. Vásárhelyi, *End-to-End Multi-Level Encoding Methods of Visual Data Compression for Robust "
    "Monocular Visual ORB-SLAM*"
)

RAW_RMSE: Final = 0.22114
"""Figure 7, without a unit; presumably meters, with both trajectories in the first frame's coordinates."""

SUCCEEDS_UP_TO: Final = {"jpeg_qf": ("qf", 15.0), "jpeg2000": ("cr_percent", 97.0), "multilevel": ("qf", 75.0)}
"""The hardest setting at which the paper's tracking succeeds, by our codec's name."""


@cache
def paper_table(name: str) -> pd.DataFrame:
    """Read `table1_jpeg`, `table2_jpeg2000`, `table3_multilevel` or `table456_operations` of the paper."""
    with (files(__package__) / f"{name}.csv").open("r") as stream:
        return pd.read_csv(stream)


KIB = 1024.0


@dataclass(frozen=True)
class Measured:
    """The numbers of a run, looked up by codec parameters."""

    run: RunResult

    @cached_property
    def _rows(self) -> dict[tuple[str, str, str], dict[str, Any]]:
        records = self.run.wide.to_dict("records")
        return {(row["sequence"], row["codec"], row["setting"]): {str(k): v for k, v in row.items()} for row in records}

    @cached_property
    def sequences(self) -> list[str]:
        """Sequences of the run, in the order of the matrix."""
        return [entry.name for entry in self.run.plan.sequences]

    @cached_property
    def settings(self) -> list[PluginSetting]:
        """Every codec setting of the run, once."""
        settings = {(r.cell.codec.name, r.cell.codec.label): r.cell.codec for r in self.run.results}
        return list(settings.values())

    def setting(self, codec: str, **params: Any) -> PluginSetting | None:
        """Return the first setting of a codec with these parameters; 5 equals 5.0."""
        for setting in self.settings:
            if setting.name == codec and all(_same(setting.params.get(key), value) for key, value in params.items()):
                return setting
        return None

    def value(self, sequence: str, setting: PluginSetting | None, column: str) -> float:
        """Return a number of the wide table, NaN if it was not measured."""
        if setting is None:
            return float("nan")
        row = self._rows.get((sequence, setting.name, setting.label), {})
        value = row.get(column)
        return float("nan") if value is None else float(value)

    def size_kib(self, sequence: str, setting: PluginSetting | None) -> float:
        """Return the mean size of a coded frame in KiB."""
        return self.value(sequence, setting, "quality.size_bytes.mean") / KIB


def _same(first: Any, second: Any) -> bool:
    if isinstance(first, int | float) and isinstance(second, int | float):
        return float(first) == float(second)
    return bool(first == second)
