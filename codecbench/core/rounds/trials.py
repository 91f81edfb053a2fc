"""Looks up the trials of settings in stored records, and requests the cells that are missing."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import scipy

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
    """Requested cells have no record yet."""


class Stopped(Exception):
    """A requested cell has no usable record, and why."""


@dataclass(frozen=True)
class Trial:
    """A trial of a setting on a sequence."""

    setting: PluginSetting
    value: float
    """As in the wide table."""
    meets: bool
    """Whether it meets the objective; with four repeats or more, with confidence."""
    runs: str = ""
    """How many runs meet it, in words; empty if there are too few for a verdict."""
    reason: str = ""
    """Why there is no value."""

    @property
    def label(self) -> str:
        return self.setting.label or "its setting"


def column_of(objective: Objective) -> Column:
    """The column of the wide table that an objective constrains."""
    return Column(objective.evaluator, objective.metric, objective.stage, objective.aggregate)


class Trials:
    """Looks up trials in the records of a run; `requested` counts the requested repeats by cell key.

    totals: the number of repeats of each evaluator's setting, by title.
    """

    def __init__(self, run: RunResult, totals: Mapping[str, int]) -> None:
        self.requested: dict[CellKey, int] = {}
        self._run, self.totals = run, totals
        self._tests: dict[tuple[str, ...], dict[Key, Test]] = {}
        self._results: dict[CellKey, dict[int, CellResult]] = defaultdict(dict)
        for result in run.results:
            cell = result.cell
            self._results[cell.sequence.name, cell.codec, cell.evaluator.title][cell.repeat] = result

    def trial(self, sequence: str, setting: PluginSetting, objective: Objective) -> Trial:
        """Compare a setting with an objective. Raises Unfinished and Stopped.

        With four repeats or more, the rate of runs that meet a limit must be above a half, with confidence; repeats are
        requested until that is decided or all are used. Fewer repeats count with the value of the table.
        """
        column, total = column_of(objective), self.totals[objective.evaluator.title]
        if objective.bound == "equal" or total < FEWEST:
            self.repeats(sequence, setting, objective.evaluator.title, total)
            value = self._value(sequence, setting, column)
            reason = self._reason(sequence, setting, column) if math.isnan(value) else ""
            return Trial(setting, value, objective.met_by(value), reason=reason)
        count = runs_to_make(0, 0, total)
        while True:
            repeats = self.repeats(sequence, setting, objective.evaluator.title, count)
            meeting = sum(any(objective.met_by(value) for value in values_in(result, column)[:1]) for result in repeats)
            outcome = verdict(meeting, count, total)
            if outcome != "inconclusive" or count == total:
                value = self._value(sequence, setting, column)
                words = f"{meeting}/{count} runs" + (", inconclusive" if outcome == "inconclusive" else "")
                reason = self._reason(sequence, setting, column) if math.isnan(value) else ""
                return Trial(setting, value, outcome == "passes", words, reason)
            count = runs_to_make(meeting, count, total)

    def repeats(self, sequence: str, setting: PluginSetting, evaluator: str, count: int) -> list[CellResult]:
        """Request the first repeats of a cell and return their results. Raises Unfinished and Stopped."""
        key = sequence, setting, evaluator
        self.requested[key] = max(count, self.requested.get(key, 0))
        results = [self._results[key].get(repeat) for repeat in range(count)]
        bad = next((result for result in results if result is not None and result.status != "ok"), None)
        if bad is not None:
            raise Stopped(f"{setting.label or 'its setting'} {bad.status}: {bad.reason}")
        present = [result for result in results if result is not None]
        if len(present) < count:
            raise Unfinished
        return present

    def stages(self, sequence: str) -> list[bool]:
        """The stages of judging a sequence's settings, the cheapest first: means over frames (False), success (True).

        Raises Unfinished before the baseline has its results, and Stopped if there are no criteria."""
        run, known = self._run, {result.cell.id for result in self._run.results}
        cells = [cell for cell in run.plan.cells if cell.sequence.name == sequence]
        if any(cell.id not in known for cell in cells if cell.codec.name in run.schema.baselines):
            raise Unfinished
        stages = sorted({_of_success(column) for columns in self._criteria(sequence) for column in columns})
        if not stages or run.rate is None:
            raise Stopped("no evaluator measures whether a setting passes, or none measures its rate")
        return stages

    def judge(self, sequence: str, setting: PluginSetting, *, succeeding: bool) -> Test:
        """Test a setting by the run's criteria: by means over frames, and, if `succeeding` and it passes, by success.

        Raises Unfinished and Stopped."""
        assert self._run.rate is not None
        tests: dict[str, Test] = {}
        for columns in self._criteria(sequence):
            means = [column for column in columns if not _of_success(column)]
            self._all_repeats(sequence, setting, [self._run.rate, *means])
            if means:
                tests[" and ".join(column.label for column in means)] = self._test(sequence, setting, means)
        if succeeding and all(test.verdict == "passes" for test in tests.values()):
            tests = {}
            for columns in self._criteria(sequence):
                self._enough_repeats(sequence, setting, columns)
                tests[columns[0].evaluator.title] = self._test(sequence, setting, columns)
        test = next(iter(tests.values()))
        return Joint(tests) if len(tests) > 1 else test if isinstance(test, Joint) else Joint({test.label: test})

    def _criteria(self, sequence: str) -> list[list[Column]]:
        """The criteria on a sequence, as far as its evaluators can be computed there."""
        there = {result.cell.evaluator for result in self._run.results
                 if result.status == "ok" and result.cell.sequence.name == sequence}  # fmt: skip
        computable = [[column for column in columns if column.evaluator in there] for columns in self._all_criteria]
        return [columns for columns in computable if columns]

    @cached_property
    def _all_criteria(self) -> list[list[Column]]:
        return criteria(self._run)

    def _test(self, sequence: str, setting: PluginSetting, columns: Sequence[Column]) -> Test:
        """The test of a measured setting by some columns."""
        key = tuple(column.name for column in columns)
        if key not in self._tests:
            self._tests[key] = tests_of(self._run, columns)
        test = self._tests[key].get((sequence, setting.name, setting.label))
        if test is None or any(is_empty(part) for part in parts(test)):
            raise Stopped(f"{setting.label} cannot be judged by {' and '.join(column.label for column in columns)}")
        return test

    def _all_repeats(self, sequence: str, setting: PluginSetting, columns: Sequence[Column]) -> None:
        """Request all repeats of the columns' evaluators before raising Unfinished for any of them."""
        missing = False
        for title in dict.fromkeys(column.evaluator.title for column in columns):
            try:
                self.repeats(sequence, setting, title, self.totals[title])
            except Unfinished:
                missing = True
        if missing:
            raise Unfinished

    def _enough_repeats(self, sequence: str, setting: PluginSetting, columns: Sequence[Column]) -> None:
        """Request repeats until it is decided whether a setting succeeds, or all are used."""
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
        """Withdraw the requests since `before` of cells that have no record."""
        for key, count in list(self.requested.items()):
            if count > before.get(key, 0):
                self.requested[key] = max(before.get(key, 0), len(self.recorded_repeats(*key)))

    def recorded_repeats(self, sequence: str, setting: PluginSetting, evaluator: str) -> list[CellResult]:
        """The repeats that have a record, up to the first that has none."""
        results = self._results[sequence, setting, evaluator]
        return [results[repeat] for repeat in range(next(n for n in range(len(results) + 1) if n not in results))]

    def table_value(self, sequence: str, setting: PluginSetting, column: Column) -> float:
        """The value of a setting in the wide table, over all repeats. Raises Unfinished and Stopped."""
        self.repeats(sequence, setting, column.evaluator.title, self.totals[column.evaluator.title])
        return self._value(sequence, setting, column)

    @cached_property
    def _rows(self) -> dict[tuple[Any, Any, Any], Any]:
        rows = self._run.wide.to_dict("records")
        return {(row["sequence"], row["codec"], row["setting"]): row for row in rows}

    def _value(self, sequence: str, setting: PluginSetting, column: Column) -> float:
        return float(self._rows[sequence, setting.name, setting.label].get(column.name, math.nan))

    def _reason(self, sequence: str, setting: PluginSetting, column: Column) -> str:
        """Why a setting has no value."""
        for result in self.recorded_repeats(sequence, setting, column.evaluator.title):
            for measured in result.measurements:
                if measured.metric == column.metric.name and measured.reason:
                    return measured.reason
        return f"{column.evaluator.title} measured no {column.measure}.{column.aggregate} here"


def _of_success(column: Column) -> bool:
    return column.metric.role == "success"


CHANCE: Final = 0.05
"""Error rate of verdicts before all runs are used, for runs whose success rate is PASSES_ABOVE."""
FEWEST: Final = 4
"""Runs below which no confidence interval lies on one side of PASSES_ABOVE."""


def stands(successes: int, runs: int) -> bool:
    """Whether the verdict on so many runs stands with confidence, however many follow."""
    mixed = float(scipy.special.betaln(successes + 1, runs - successes + 1))
    at_limit = successes * math.log(PASSES_ABOVE) + (runs - successes) * math.log(1.0 - PASSES_ABOVE)
    return mixed - at_limit >= -math.log(CHANCE)


def verdict(successes: int, runs: int, most: int) -> Passing:
    """The verdict on so many of at most `most` runs; `inconclusive` while more are to come or would be needed."""
    if stands(successes, runs):
        return "passes" if successes > PASSES_ABOVE * runs else "fails"
    return Standing("", math.nan, successes, runs).verdict if 0 < most <= runs else "inconclusive"


def runs_to_make(successes: int, runs: int, most: int) -> int:
    """How many runs there have to be in all before the next verdict, at most `most`.

    It is as few as could decide if all further runs end as most have.
    """
    gained = int(successes >= PASSES_ABOVE * runs)
    more = next(
        more for more in range(most + 1) if runs + more >= most or stands(successes + gained * more, runs + more)
    )
    return min(most, runs + max(more, 1))
