"""What stored records say of settings that are tried, and which cells are missing to say it."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

from codecbench.core.analysis.columns import Column
from codecbench.core.analysis.passing import PASSES_ABOVE, Passing, Standing
from codecbench.core.analysis.run_result import RunResult
from codecbench.core.analysis.table import CellResult
from codecbench.core.analysis.verdicts import values_in
from codecbench.core.engine.planning.aim import Aim
from codecbench.core.engine.planning.model import PluginSetting

CellKey = tuple[str, PluginSetting, str]
"""A sequence by its name, a codec setting, and an evaluator's setting by its title."""


class Unfinished(Exception):
    """Cells that are asked for have no record yet."""


class Stopped(Exception):
    """A cell that is asked for has none that says anything, and why."""


@dataclass(frozen=True)
class Trial:
    """A setting as it was tried on a sequence.

    value: what the table shows. meets: whether that will do; for repeats with confidence. runs: what they say, empty
    where there are too few to say more than their value. reason: why there is no value.
    """

    setting: PluginSetting
    value: float
    meets: bool
    runs: str = ""
    reason: str = ""

    @property
    def label(self) -> str:
        return self.setting.label or "its setting"


def column_of(aim: Aim) -> Column:
    """The column of the wide table that an aim is about."""
    return Column(aim.evaluator, aim.metric, aim.stage, aim.aggregate)


class Trials:
    """Looks up trials in the records of a run; `asked` is how many repeats were asked for of each sort of cell.

    totals: the repeats that each evaluator's setting has, by title.
    """

    def __init__(self, run: RunResult, totals: Mapping[str, int]) -> None:
        self.asked: dict[CellKey, int] = {}
        self._run, self.totals = run, totals
        self._found: dict[CellKey, dict[int, CellResult]] = defaultdict(dict)
        for result in run.results:
            cell = result.cell
            self._found[cell.sequence.name, cell.codec, cell.evaluator.title][cell.repeat] = result

    def trial(self, sequence: str, setting: PluginSetting, aim: Aim) -> Trial:
        """What is known of a setting beside an aim. Raises Unfinished and Stopped.

        With four repeats or more, a limit must be met by more than half of all runs there could be, with confidence;
        repeats are asked for until that stands, or there are no more. Fewer count with the value of the table.
        """
        column, total = column_of(aim), self.totals[aim.evaluator.title]
        if aim.bound == "equal" or total < FEWEST:
            self.repeats(sequence, setting, aim.evaluator.title, total)
            value = self._shown(sequence, setting, column)
            reason = self._reason(sequence, setting, column) if math.isnan(value) else ""
            return Trial(setting, value, aim.met_by(value), reason=reason)
        count = runs_to_make(0, 0, total)
        while True:
            repeats = self.repeats(sequence, setting, aim.evaluator.title, count)
            held = sum(any(aim.met_by(value) for value in values_in(result, column)[:1]) for result in repeats)
            said = verdict(held, count, total)
            if said != "inconclusive" or count == total:
                value = self._shown(sequence, setting, column)
                words = f"{held}/{count} runs" + (", inconclusive" if said == "inconclusive" else "")
                reason = self._reason(sequence, setting, column) if math.isnan(value) else ""
                return Trial(setting, value, said == "passes", words, reason)
            count = runs_to_make(held, count, total)

    def repeats(self, sequence: str, setting: PluginSetting, evaluator: str, count: int) -> list[CellResult]:
        """The first repeats of a cell, which all have a result. Raises Unfinished and Stopped."""
        key = sequence, setting, evaluator
        self.asked[key] = max(count, self.asked.get(key, 0))
        found = [self._found[key].get(repeat) for repeat in range(count)]
        bad = next((result for result in found if result is not None and result.status != "ok"), None)
        if bad is not None:
            raise Stopped(f"{setting.label or 'its setting'} {bad.status}: {bad.reason}")
        present = [result for result in found if result is not None]
        if len(present) < count:
            raise Unfinished
        return present

    def recorded(self, sequence: str, setting: PluginSetting, evaluator: str) -> list[CellResult]:
        """The repeats that have a record, up to the first that has none."""
        found = self._found[sequence, setting, evaluator]
        return [found[repeat] for repeat in range(next(n for n in range(len(found) + 1) if n not in found))]

    def shown(self, sequence: str, setting: PluginSetting, column: Column) -> float:
        """The value of a setting that the wide table shows, of all repeats. Raises Unfinished and Stopped."""
        self.repeats(sequence, setting, column.evaluator.title, self.totals[column.evaluator.title])
        return self._shown(sequence, setting, column)

    @cached_property
    def _rows(self) -> dict[tuple[Any, Any, Any], Any]:
        rows = self._run.wide.to_dict("records")
        return {(row["sequence"], row["codec"], row["setting"]): row for row in rows}

    def _shown(self, sequence: str, setting: PluginSetting, column: Column) -> float:
        return float(self._rows[sequence, setting.name, setting.label].get(column.name, math.nan))

    def _reason(self, sequence: str, setting: PluginSetting, column: Column) -> str:
        """Why a setting has no value."""
        for result in self.recorded(sequence, setting, column.evaluator.title):
            for measured in result.measurements:
                if measured.metric == column.metric.name and measured.reason:
                    return measured.reason
        return f"{column.evaluator.title} gives no {column.measure}.{column.aggregate} here"


CHANCE: Final = 0.05
"""That runs whose success rate is PASSES_ABOVE are ever said to pass, or to fail, before all are spent."""
FEWEST: Final = 4
"""Runs below which no interval lies on one side of PASSES_ABOVE."""


def stands(successes: int, runs: int) -> bool:
    """Whether the verdict on so many runs would stand whatever comes after them."""
    from scipy.special import betaln  # loads for a quarter of a second, and few runs are added to

    mixed = float(betaln(successes + 1, runs - successes + 1))
    at_limit = successes * math.log(PASSES_ABOVE) + (runs - successes) * math.log(1.0 - PASSES_ABOVE)
    return mixed - at_limit >= -math.log(CHANCE)


def verdict(successes: int, runs: int, most: int) -> Passing:
    """What so many of at most `most` runs say; `inconclusive` while more of them are to come or would be needed."""
    if stands(successes, runs):
        return "passes" if successes > PASSES_ABOVE * runs else "fails"
    return Standing("", math.nan, successes, runs).verdict if 0 < most <= runs else "inconclusive"


def runs_to_make(successes: int, runs: int, most: int) -> int:
    """How many runs there are to be in all before the verdict is looked at again, at most `most`.

    As few as could decide, if all to come end as most have.
    """
    gained = int(successes >= PASSES_ABOVE * runs)
    more = next(
        more for more in range(most + 1) if runs + more >= most or stands(successes + gained * more, runs + more)
    )
    return min(most, runs + max(more, 1))
