"""Searches the parameters of a codec on a sequence, as far as the records of its trials allow."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final, Literal, TypeVar

import numpy as np

from codecbench.core.analysis.run_result import Column
from codecbench.core.engine.planning.model import PluginSetting, SearchFinding, SearchState
from codecbench.core.engine.planning.objective import Objective
from codecbench.core.engine.planning.search import Search
from codecbench.core.rounds.trials import Stopped, Trial, Trials, Unfinished

A = TypeVar("A")
E = TypeVar("E")

_SHOWN: Final = 5
"""Trials that a finding names of those against the direction."""


@dataclass
class ParameterSearch:
    """A search on a sequence, which repeats from its start with the records that there are."""

    search: Search
    sequence: str
    trials: Trials
    seed: int
    in_time: bool = True
    """Whether it may request more cells."""
    tried: dict[int, Trial] = field(default_factory=dict)
    """Trials by the place of a setting, in the order of the search."""

    def result(self) -> tuple[SearchFinding, PluginSetting | None]:
        """The finding so far, and the setting for every evaluator; requests missing cells from `trials`."""
        try:
            if len(self.search.axes) > 1:
                self._follow(sampling(self.search.lengths, self.search.budget, self.seed), self._score)
                return self._best_of_several()
            ended = self._follow(bisection(len(self.search.settings), self.search.budget), self._side)
            return self._nearest(ended) if self._objective.bound == "equal" else self._boundary(ended)
        except Unfinished:
            if self.in_time:
                return self._finding("under way", None, f"{len(self.tried)} settings tried so far"), None
            return self._finding("stopped", None, f"no time left; {self._effort()}"), None
        except Stopped as stop:
            return self._finding("stopped", None, f"stopped: {stop}; the next run tries again"), None

    @property
    def _objective(self) -> Objective:
        assert self.search.objective is not None, "what passes is sought by Edge"
        return self.search.objective

    def _follow(self, questions: Generator[list[int], dict[int, A], E], answer: Callable[[int], A]) -> E:
        """Answer questions to their end. Raises Stopped, and Unfinished after requesting all cells of a question."""
        try:
            places = next(questions)
            while True:
                self._try(places)
                places = questions.send({place: answer(place) for place in places})
        except StopIteration as ended:
            result: E = ended.value
            return result

    def _try(self, places: list[int]) -> None:
        unfinished = False
        for place in places:
            setting = self.search.settings[place]
            try:
                self.tried[place] = self.trials.trial(self.sequence, setting, self._objective)
            except Unfinished:
                unfinished = True
            if self.search.least is not None:
                evaluator, _ = self.search.least
                try:
                    self.trials.repeats(self.sequence, setting, evaluator.title, self.trials.totals[evaluator.title])
                except Unfinished:
                    unfinished = True
        if unfinished:
            raise Unfinished

    def _side(self, place: int) -> Side:
        trial, objective = self.tried[place], self._objective
        if objective.bound != "equal":
            return 1 if trial.meets else -1
        if math.isnan(trial.value):
            raise Stopped(f"{trial.label} has no value: {trial.reason}")
        if abs(trial.value - objective.value) <= self.search.within or trial.value == objective.value:
            return 0
        return 1 if trial.value > objective.value else -1

    def _score(self, place: int) -> Score:
        trial, objective = self.tried[place], self._objective
        if objective.bound == "equal":
            return Score(0.0 if self._near_enough(trial) else objective.distance(trial.value), 0.0)
        distance = objective.distance(trial.value)
        violation = 0.0 if trial.meets else min(distance, 1e9) or 1.0
        return Score(self._least(place), violation)

    def _least(self, place: int) -> float:
        """The value of a setting that is to be least; 0 if the search has none."""
        if self.search.least is None:
            return 0.0
        evaluator, metric = self.search.least
        column = Column(evaluator, metric, "", metric.aggregates[0])
        value = self.trials.table_value(self.sequence, self.search.settings[place], column)
        return math.inf if math.isnan(value) else value

    def _nearest(self, ended: BisectionResult | None) -> tuple[SearchFinding, PluginSetting | None]:
        """The setting that comes nearest to an objective."""
        objective = self._objective
        place = min(self.tried, key=lambda place: (objective.distance(self.tried[place].value), place))
        trial = self.tried[place]
        if not math.isfinite(trial.value) and math.isfinite(objective.value) and trial.value != objective.value:
            return self._finding("unreachable", None, f"no setting has a finite value; {self._effort()}"), None
        words = f"{trial.label} gives {_number(trial.value)}{_off(trial.value, objective.value)}"
        state: SearchState = "nearest"
        if ended is not None and ended.outcome == "one side":
            state, words = "unreachable", f"no setting reaches the target; at the nearer end, {words}"
        elif ended is not None and ended.outcome == "spent":
            state, words = "stopped", f"the budget is spent; the nearest setting tried: {words}"
        elif self._near_enough(trial):
            state = "found"
        return self._finding(state, trial, f"{words}; {self._effort()}"), trial.setting

    def _near_enough(self, trial: Trial) -> bool:
        return abs(trial.value - self._objective.value) <= self.search.within

    def _boundary(self, ended: BisectionResult) -> tuple[SearchFinding, PluginSetting | None]:
        """The last setting that meets the objective before those that do not."""
        objective, meeting = self._objective, {place: trial for place, trial in self.tried.items() if trial.meets}
        if not meeting:
            best = min(self.tried.values(), key=lambda trial: objective.distance(trial.value))
            came = f"the nearest is {self._describe(best)}" if not math.isnan(best.value) else best.reason
            state: SearchState = "stopped" if ended.outcome == "spent" else "unreachable"
            spent = "the budget is spent, and " if ended.outcome == "spent" else ""
            return self._finding(
                state, None, f"{spent}no setting tried meets the objective: {came}; {self._effort()}"
            ), None
        if ended.outcome == "one side" or len(meeting) == len(self.tried):
            place = min(meeting, key=lambda place: (objective.distance(meeting[place].value), -place))
            words = f"every setting tried meets the objective, even {self._describe(meeting[place])}"
        else:
            place = ended.low if ended.low in meeting else ended.high
            other = ended.high if place == ended.low else ended.low
            words = (
                f"{self._describe(meeting[place])} meets the objective, {self._describe(self.tried[other])} does not"
            )
        if ended.outcome == "spent":
            return self._finding("stopped", meeting[place], f"the budget is spent; {words}; {self._effort()}"), (
                meeting[place].setting
            )
        return self._finding("found", meeting[place], f"{words}; {self._effort()}"), meeting[place].setting

    def _best_of_several(self) -> tuple[SearchFinding, PluginSetting | None]:
        """The best setting tried of several parameters."""
        if self._objective.bound == "equal":
            return self._nearest(None)
        meeting = [place for place, trial in self.tried.items() if trial.meets]
        if not meeting:
            return self._boundary(BisectionResult("one side", 0, 0))
        place = min(meeting, key=self._least)
        words = f"{self._describe(self.tried[place])} meets the objective"
        if self.search.least is not None:
            _, metric = self.search.least
            words += f", at the least {metric.name} ({_number(self._least(place))})"
        return self._finding("found", self.tried[place], f"{words}; {self._effort()}"), self.search.settings[place]

    def _describe(self, trial: Trial) -> str:
        """A trial with its value and its runs."""
        value = "no value" if math.isnan(trial.value) else _number(trial.value)
        return f"{trial.label} ({', '.join(filter(None, (value, trial.runs)))})"

    def _effort(self) -> str:
        words = f"{len(self.tried)} of {len(self.search.settings)} settings tried"
        against = self._reversals()
        return f"{words}; not monotone: {against}" if against else words

    def _reversals(self) -> str:
        """Trials between which the value goes against its direction; empty if repeats scatter it."""
        if len(self.search.axes) > 1 or any(trial.runs for trial in self.tried.values()):
            return ""
        places = sorted(place for place in self.tried if not math.isnan(self.tried[place].value))
        rising = self.tried[places[-1]].value >= self.tried[places[0]].value if places else True
        turns = []
        for before, after in pairwise(places):
            first, second = self.tried[before], self.tried[after]
            if first.value != second.value and (second.value > first.value) != rising:
                turns.append(f"{_number(first.value)} at {first.label}, {_number(second.value)} at {second.label}")
        return ", ".join(turns[:_SHOWN])

    def _finding(self, state: SearchState, trial: Trial | None, words: str) -> SearchFinding:
        reached = trial.value if trial is not None and math.isfinite(trial.value) else None
        codec = self.search.settings[0].name
        label = trial.setting.label if trial is not None else ""
        return SearchFinding(self.sequence, codec, str(self._objective), state, label, reached, len(self.tried), words)


def _number(value: float) -> str:
    return f"{value:.4g}"


def _off(value: float, target: float) -> str:
    """The relative distance of a value from a target, in words."""
    return f", {100.0 * (value - target) / abs(target):+.2g} %" if target and value != target else ""


Side = Literal[-1, 0, 1]
"""Which side of the target a place is on; 0 if it is the target."""


@dataclass(frozen=True)
class BisectionResult:
    """The end of a bisection between two places."""

    outcome: Literal["crossed", "hit", "one side", "spent"]
    """crossed: low and high are neighbors on different sides. hit: one of the places tried is the target. one side:
    both ends are on the same side, and so is their middle. spent: the budget is used up."""
    low: int
    high: int


def bisection(length: int, budget: int) -> Generator[list[int], dict[int, Side], BisectionResult]:
    """Yield places below `length`, at most `budget`; receive the side of each.

    If both ends are on one side, their middle is tried as well, in case the parameter is not monotone.
    """
    low, high = 0, length - 1
    sides = yield [low, high][:budget]
    if budget < 2:
        return BisectionResult("hit" if 0 in sides.values() else "spent", low, high)
    if sides[low] == sides[high] != 0:
        if length == 2 or budget == 2:
            return BisectionResult("one side" if length == 2 else "spent", low, high)
        middle = length // 2
        sides |= yield [middle]
        if sides[middle] == sides[low]:
            return BisectionResult("one side", low, high)
        high = middle
    while 0 not in sides.values() and high - low > 1:
        if len(sides) >= budget:
            return BisectionResult("spent", low, high)
        middle = (low + high) // 2
        sides |= yield [middle]
        low, high = (middle, high) if sides[middle] == sides[low] else (low, middle)
    return BisectionResult("hit" if 0 in sides.values() else "crossed", low, high)


_AT_ONCE: Final = 4
"""Settings that are tried in the same round."""
_BARRED: Final = 1e12
"""More than any cost, so that settings that violate the objective come last; the sampler only uses the order."""


@dataclass(frozen=True)
class Score:
    """The score of a place."""

    cost: float
    """To be least; infinite if unknown."""
    violation: float
    """Above 0 if the place does not meet the objective."""


def sampling(lengths: Sequence[int], budget: int, seed: int) -> Generator[list[int], dict[int, Score], None]:
    """Yield places in the flat order of all combinations, at most `budget`; receive the score of each."""
    import optuna  # slow to load, and few runs search several parameters

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    sampler = optuna.samplers.TPESampler(seed=seed, n_startup_trials=min(10, budget // 2))
    study = optuna.create_study(sampler=sampler)
    known: dict[int, Score] = {}
    most = min(budget, math.prod(lengths))
    for _ in range(10 * budget):  # the sampler may suggest a place again
        if len(known) >= most or Score(0.0, 0.0) in known.values():
            return
        suggested = [study.ask() for _ in range(min(_AT_ONCE, most - len(known)))]
        axes = [*enumerate(lengths)]
        parts = ([trial.suggest_int(str(axis), 0, length - 1) for axis, length in axes] for trial in suggested)
        places = [int(np.ravel_multi_index(part, lengths)) for part in parts]
        new = [place for place in dict.fromkeys(places) if place not in known]
        if new:
            known |= yield new
        for trial, place in zip(suggested, places, strict=True):
            score = known[place]
            study.tell(trial, min(score.cost, _BARRED) if score.violation == 0.0 else _BARRED * (1.0 + score.violation))
