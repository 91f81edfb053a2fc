"""Searches: a codec entry whose axes say what may be tried, and which of these settings is sought.

    - use: jpeg
      params: {quality: {range: [1, 100]}}
      search: {metric: psnr_gray_db, min: 35}          # or, for short, `at: {rate_bpp: 0.5}`; or `passes`

Without `search` the axes of an entry are a sweep: all of their settings are in the plan. With it none is at first. The
plan grows in rounds: when all of its cells have ended, `core.rounds` reads what was stored, finds out which
settings the searches try next, and makes the plan again with an `Extent` that says which cells of the settings that
are not swept belong to it. Those are cells like any other, with the identities that they would have in a sweep. The
extent follows from the matrix and the stored records alone, so that a run that was stopped finds its way again.

`run: {until: ...}` grows the plan in the same way: of an evaluator's repeats there are at first only as many as the
extent says.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from codecbench.core.contracts.metric import Metric
from codecbench.core.engine.planning.axes import Axis
from codecbench.core.engine.planning.entry import Entry
from codecbench.core.engine.planning.model import PluginSetting
from codecbench.core.engine.planning.objective import Objective, find_objective, metrics_of
from codecbench.core.engine.planning.yaml_file import Problems, Where

ALL_REPEATS: Final = 1 << 30
"""More repeats than an evaluator can have."""


@dataclass(frozen=True)
class Search:
    """A codec entry with an objective. axes: of more than one value. settings: of all their combinations, the last axis
    turning fastest. least: of the settings that will do, the one with the least of this column is sought; None where
    there is one axis, of which the last setting that will do is. objective: None if the coarsest setting is sought
    that passes what is asked of the run.
    """

    objective: Objective | None
    axes: tuple[Axis, ...]
    settings: tuple[PluginSetting, ...]
    within: float = 0.0
    budget: int = ALL_REPEATS
    least: tuple[PluginSetting, Metric] | None = None

    @property
    def lengths(self) -> tuple[int, ...]:
        return tuple(len(axis) for axis in self.axes)

    @property
    def evaluators(self) -> tuple[PluginSetting, ...]:
        """Those that a trial needs, as far as the matrix says it."""
        return tuple(dict.fromkeys((*([self.objective.evaluator] if self.objective else ()), *(self.least or ())[:1])))


@dataclass(frozen=True)
class PlanScope:
    """Which cells belong to the plan where not all do.

    repeats: how many of a sequence (by name), codec setting and evaluator (by title). begun: how many of an evaluator
    by title whose repeats are added as needed, where `repeats` does not say; all of the others. Of the settings of a
    search there are none where `repeats` does not say. inputs: what the cells of an evaluator that awaits something
    have been waiting for, or why it will never be there; those of which it does not say do not belong to the plan yet.
    """

    repeats: Mapping[tuple[str, PluginSetting, str], int] = field(default_factory=dict)
    begun: Mapping[str, int] = field(default_factory=dict)
    inputs: Mapping[tuple[str, PluginSetting, str], dict[str, float] | str] = field(default_factory=dict)

    def planned(self, sequence: str, codec: PluginSetting, evaluator: str, searched: bool) -> int:
        """How many repeats are in the plan. searched: the codec setting is one that a search may try."""
        begun = 0 if searched else self.begun.get(evaluator, ALL_REPEATS)
        return max(begun, self.repeats.get((sequence, codec, evaluator), 0))


def find_searches(codecs: Sequence[Entry], evaluators: Sequence[Entry], problems: Problems) -> tuple[Search, ...]:
    """The searches of a matrix, their metrics found among what its evaluators declare."""
    members: dict[Where, list[Entry]] = {}
    for entry in codecs:
        if entry.wanted is not None:
            members.setdefault(entry.wanted.where, []).append(entry)
    searches = []
    for where, entries in members.items():
        wanted = entries[0].wanted
        assert wanted is not None
        settings = tuple(entry.setting for entry in entries)
        if wanted.section is None:
            if not any(entry.description and entry.description.declared["reference"] == "baseline" for entry in codecs):
                problems.add(where, "a setting passes beside the baseline, and there is none; add the codec raw")
            searches.append(Search(None, wanted.axes, settings))
            continue
        objective = find_objective(wanted.section, evaluators, where, problems)
        if objective is not None:
            least = _rate_of(evaluators) if len(wanted.axes) > 1 else None
            searches.append(
                Search(objective, wanted.axes, settings, wanted.section.within, wanted.section.budget, least)
            )
    return tuple(searches)


def _rate_of(evaluators: Sequence[Entry]) -> tuple[PluginSetting, Metric] | None:
    """What codecs spend: the first headline of that role."""
    for entry in evaluators:
        for metric in metrics_of(entry):
            if metric.headline and metric.role == "rate" and metric.better == "lower":
                return entry.setting, metric
    return None
