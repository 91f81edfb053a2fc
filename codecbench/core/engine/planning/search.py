"""Searches: a codec entry's axes list the settings that may be tried, and an objective says which one is sought.

    - use: jpeg
      params: {quality: {range: [1, 100]}}
      search: {metric: psnr_gray_db, min: 35}          # or, for short, `at: {rate_bpp: 0.5}`; or `passes`

Without `search` the axes are a sweep: all of their settings are in the plan. With `search` none is at first, and the
plan grows in rounds. When all of its cells have ended, `core.rounds` reads the results, determines which settings the
searches try next, and makes the plan again with a `PlanScope` that adds their cells. These cells have the same
identities as in a sweep. The scope depends only on the matrix and the stored records, so a stopped run resumes
correctly.

`run: {until: ...}` grows the plan in the same way: at first it has only as many repeats of an evaluator as the scope
says.
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
    """A codec entry with an objective."""

    objective: Objective | None
    """None for the coarsest setting that passes what is asked of the run."""
    axes: tuple[Axis, ...]
    """Axes with more than one value."""
    settings: tuple[PluginSetting, ...]
    """All combinations of the axes' values; the last axis varies fastest."""
    within: float = 0.0
    budget: int = ALL_REPEATS
    least: tuple[PluginSetting, Metric] | None = None
    """Column to minimize among settings that meet the objective; None for one axis: its last such setting."""

    @property
    def lengths(self) -> tuple[int, ...]:
        return tuple(len(axis) for axis in self.axes)

    @property
    def evaluators(self) -> tuple[PluginSetting, ...]:
        """The evaluators that a trial needs, as far as the matrix names them."""
        return tuple(dict.fromkeys((*([self.objective.evaluator] if self.objective else ()), *(self.least or ())[:1])))


@dataclass(frozen=True)
class PlanScope:
    """Which cells belong to the plan if not all of them do."""

    repeats: Mapping[tuple[str, PluginSetting, str], int] = field(default_factory=dict)
    """Number of repeats by sequence name, codec setting and evaluator title. Searched settings have none by default."""
    begun: Mapping[str, int] = field(default_factory=dict)
    """Default number of repeats by evaluator title, for evaluators whose repeats are added as needed."""
    inputs: Mapping[tuple[str, PluginSetting, str], dict[str, float] | str] = field(default_factory=dict)
    """Inputs of an evaluator's cells, or why they will never be available.

    Cells that require inputs and are not listed are not in the plan yet.
    """

    def planned(self, sequence: str, codec: PluginSetting, evaluator: str, searched: bool) -> int:
        """Return how many repeats are in the plan. searched: whether only a search may try the codec setting."""
        begun = 0 if searched else self.begun.get(evaluator, ALL_REPEATS)
        return max(begun, self.repeats.get((sequence, codec, evaluator), 0))


def find_searches(codecs: Sequence[Entry], evaluators: Sequence[Entry], problems: Problems) -> tuple[Search, ...]:
    """Return the searches of a matrix, with their metrics resolved among what its evaluators declare."""
    members: dict[Where, list[Entry]] = {}
    for entry in codecs:
        if entry.search is not None:
            members.setdefault(entry.search.where, []).append(entry)
    searches = []
    for where, entries in members.items():
        spec = entries[0].search
        assert spec is not None
        settings = tuple(entry.setting for entry in entries)
        if spec.section is None:
            if not any(entry.description and entry.description.declared["reference"] == "baseline" for entry in codecs):
                problems.add(where, "`search: passes` compares with a baseline; add the codec raw")
            searches.append(Search(None, spec.axes, settings))
            continue
        objective = find_objective(spec.section, evaluators, where, problems)
        if objective is not None:
            least = _rate_of(evaluators) if len(spec.axes) > 1 else None
            searches.append(Search(objective, spec.axes, settings, spec.section.within, spec.section.budget, least))
    return tuple(searches)


def _rate_of(evaluators: Sequence[Entry]) -> tuple[PluginSetting, Metric] | None:
    """Return the codecs' rate: the first primary metric with role `rate`."""
    for entry in evaluators:
        for metric in metrics_of(entry):
            if metric.headline and metric.role == "rate" and metric.better == "lower":
                return entry.setting, metric
    return None
