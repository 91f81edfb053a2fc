"""What stored records say of settings that are tried, and which cells are missing to say it."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

from codecbench.core.analysis.limits import criteria, is_empty, tests_of
from codecbench.core.analysis.passing import PASSES_ABOVE, Joint, Passing, Standing, Test, parts
from codecbench.core.analysis.run_result import Column, Key, RunResult
from codecbench.core.analysis.table import CellResult
from codecbench.core.analysis.verdicts import values_in
from codecbench.core.engine.planning.model import PluginSetting
from codecbench.core.engine.planning.objective import Objective

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


def column_of(objective: Objective) -> Column:
    """The column of the wide table that an objective is about."""
    return Column(objective.evaluator, objective.metric, objective.stage, objective.aggregate)


class Trials:
    """Looks up trials in the records of a run; `asked` is how many repeats were asked for of each sort of cell.

    totals: the repeats that each evaluator's setting has, by title.
    """

    def __init__(self, run: RunResult, totals: Mapping[str, int]) -> None:
        self.asked: dict[CellKey, int] = {}
        self._run, self.totals = run, totals
        self._tests: dict[tuple[str, ...], dict[Key, Test]] = {}
        self._found: dict[CellKey, dict[int, CellResult]] = defaultdict(dict)
        for result in run.results:
            cell = result.cell
            self._found[cell.sequence.name, cell.codec, cell.evaluator.title][cell.repeat] = result

    def trial(self, sequence: str, setting: PluginSetting, objective: Objective) -> Trial:
        """What is known of a setting beside an objective. Raises Unfinished and Stopped.

        With four repeats or more, a limit must be met by more than half of all runs there could be, with confidence;
        repeats are asked for until that stands, or there are no more. Fewer count with the value of the table.
        """
        column, total = column_of(objective), self.totals[objective.evaluator.title]
        if objective.bound == "equal" or total < FEWEST:
            self.repeats(sequence, setting, objective.evaluator.title, total)
            value = self._shown(sequence, setting, column)
            reason = self._reason(sequence, setting, column) if math.isnan(value) else ""
            return Trial(setting, value, objective.met_by(value), reason=reason)
        count = runs_to_make(0, 0, total)
        while True:
            repeats = self.repeats(sequence, setting, objective.evaluator.title, count)
            held = sum(any(objective.met_by(value) for value in values_in(result, column)[:1]) for result in repeats)
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

    def stages(self, sequence: str) -> list[bool]:
        """By what the settings of a sequence are judged, the cheapest first: by means over frames, and (True) by
        success. Raises Unfinished before the baseline has its results, and Stopped if nothing judges them."""
        run, known = self._run, {result.cell.id for result in self._run.results}
        cells = [cell for cell in run.plan.cells if cell.sequence.name == sequence]
        if any(cell.id not in known for cell in cells if cell.codec.name in run.schema.baselines):
            raise Unfinished
        found = sorted({_of_success(column) for columns in self._criteria(sequence) for column in columns})
        if not found or run.rate is None:
            raise Stopped("no evaluator says whether a setting passes, or none what it spends")
        return found

    def judged(self, sequence: str, setting: PluginSetting, *, succeeding: bool) -> Test:
        """Whether a setting passes what is asked of the run: by means over frames and, if it passes by them and
        `succeeding`, by success. Raises Unfinished and Stopped."""
        assert self._run.rate is not None
        found: dict[str, Test] = {}
        for columns in self._criteria(sequence):
            means = [column for column in columns if not _of_success(column)]
            self._all_repeats(sequence, setting, [self._run.rate, *means])
            if means:
                found[" and ".join(column.label for column in means)] = self._test(sequence, setting, means)
        if succeeding and all(test.verdict == "passes" for test in found.values()):
            found = {}
            for columns in self._criteria(sequence):
                self._enough_repeats(sequence, setting, columns)
                found[columns[0].evaluator.title] = self._test(sequence, setting, columns)
        test = next(iter(found.values()))
        return Joint(found) if len(found) > 1 else test if isinstance(test, Joint) else Joint({test.label: test})

    def _criteria(self, sequence: str) -> list[list[Column]]:
        """What is asked on a sequence, as far as its evaluators can be computed there."""
        there = {result.cell.evaluator for result in self._run.results
                 if result.status == "ok" and result.cell.sequence.name == sequence}  # fmt: skip
        asked = [[column for column in columns if column.evaluator in there] for columns in self._asked_of_all]
        return [columns for columns in asked if columns]

    @cached_property
    def _asked_of_all(self) -> list[list[Column]]:
        return criteria(self._run)

    def _test(self, sequence: str, setting: PluginSetting, columns: Sequence[Column]) -> Test:
        """What columns say of a setting that was measured."""
        key = tuple(column.name for column in columns)
        if key not in self._tests:
            self._tests[key] = tests_of(self._run, columns)
        test = self._tests[key].get((sequence, setting.name, setting.label))
        if test is None or any(is_empty(part) for part in parts(test)):
            raise Stopped(f"{setting.label} cannot be judged by {' and '.join(column.label for column in columns)}")
        return test

    def _all_repeats(self, sequence: str, setting: PluginSetting, columns: Sequence[Column]) -> None:
        """Ask for all repeats of the evaluators of columns, before any is found missing."""
        missing = False
        for title in dict.fromkeys(column.evaluator.title for column in columns):
            try:
                self.repeats(sequence, setting, title, self.totals[title])
            except Unfinished:
                missing = True
        if missing:
            raise Unfinished

    def _enough_repeats(self, sequence: str, setting: PluginSetting, columns: Sequence[Column]) -> None:
        """Ask for repeats until it stands whether a setting succeeds, or there are no more."""
        counted = [column for column in columns if _of_success(column)]
        title = counted[0].evaluator.title
        total = self.totals[title]
        count = runs_to_make(0, 0, total)
        while True:
            self.repeats(sequence, setting, title, count)
            (standing,) = parts(self._test(sequence, setting, counted))
            assert isinstance(standing, Standing)
            if count == total or stands(standing.successes, standing.runs):
                return
            count = min(total, count + runs_to_make(standing.successes, standing.runs, total) - standing.runs)

    def withdraw(self, before: Mapping[CellKey, int]) -> None:
        """Ask no more, of what was asked for since `before`, than what is recorded."""
        for key, count in list(self.asked.items()):
            if count > before.get(key, 0):
                self.asked[key] = max(before.get(key, 0), len(self.recorded(*key)))

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


def _of_success(column: Column) -> bool:
    return column.metric.role == "success"


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
