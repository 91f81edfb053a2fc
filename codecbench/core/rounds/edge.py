"""Searches the edge of a codec on a sequence: the coarsest setting that passes the run's criteria."""

from __future__ import annotations

from dataclasses import dataclass, field

from codecbench.core.analysis.passing import Test, describe
from codecbench.core.engine.planning.model import PluginSetting, SearchFinding, SearchState
from codecbench.core.engine.planning.search import Search
from codecbench.core.engine.planning.search_section import PASSES
from codecbench.core.rounds.trials import Stopped, Trials, Unfinished


@dataclass
class Edge:
    """Bisects the settings of an axis, whose direction follows from the rates of those tried.

    It first bisects by means over frames, for which one cell suffices. Then it bisects by success, which takes several
    runs: only of the edge by means, and of finer settings if that fails.
    """

    search: Search
    sequence: str
    trials: Trials
    in_time: bool = True
    """Whether it may request more cells."""
    tried: dict[int, Test] = field(default_factory=dict)
    """Tests by the place of a setting on the axis."""
    low: int = -1
    """Place, from the coarsest setting, of the last that does not pass."""
    high: int = 0
    """Place, from the coarsest setting, of the first that passes."""
    proven: bool = False
    """Whether `high` passes in all stages."""

    def result(self) -> tuple[SearchFinding, PluginSetting | None]:
        """The finding so far, and the setting for every evaluator; requests missing cells from `trials`."""
        self.high = len(self.search.settings)
        try:
            stages = self.trials.stages(self.sequence)
            for succeeding in stages:
                self.proven = succeeding == stages[-1]
                self._bisect(succeeding=succeeding, first_at_low=len(stages) > 1 and succeeding)
        except Unfinished:
            return self._partial()
        except Stopped as stop:
            return self._finding("stopped", None, f"stopped: {stop}; the next run tries again"), None
        return self._final()

    def _bisect(self, *, succeeding: bool, first_at_low: bool) -> None:
        passing: set[int] = set()
        has_tried = False
        while True:
            order = list(enumerate(self._order))
            failing = [at for at, place in order if place in self.tried and self.tried[place].verdict != "passes"]
            self.low = max(failing, default=-1)
            self.high = min((at for at, place in order if place in passing and at > self.low), default=len(order))
            if self.high - self.low < 2:
                return
            at = self.low + 1 if first_at_low and not has_tried else (self.low + self.high) // 2
            place, has_tried = order[at][1], True
            self.tried[place] = self.trials.judge(self.sequence, self.search.settings[place], succeeding=succeeding)
            if self.tried[place].verdict == "passes":
                passing.add(place)

    @property
    def _order(self) -> list[int]:
        """The places from the coarsest setting to the finest."""
        places = list(range(len(self.search.settings)))
        falling = self.tried and self.tried[max(self.tried)].rate < self.tried[min(self.tried)].rate
        return places[::-1] if falling else places

    def _final(self) -> tuple[SearchFinding, PluginSetting | None]:
        order = self._order
        if self.high == len(order):
            return self._finding("unreachable", None, f"no setting passes: {self._describe(order[-1])}"), None
        words = self._describe(order[self.high])
        words += f"; {self._describe(order[self.low])}" if self.low >= 0 else "; it is the end of the axis"
        setting = self.search.settings[order[self.high]]
        return self._finding("found", setting, words), setting

    def _partial(self) -> tuple[SearchFinding, PluginSetting | None]:
        order = self._order
        ends = dict.fromkeys(self.search.settings[order[at]].label for at in (self.low + 1, self.high - 1))
        if self.in_time:
            return self._finding("under way", None, f"searching from {' to '.join(ends)}"), None
        words = f"no time left to try {' to '.join(ends)}"
        if not self.proven or self.high == len(order):
            return self._finding("stopped", None, words), None
        setting = self.search.settings[order[self.high]]
        return self._finding("stopped", setting, f"{words}; {self._describe(order[self.high])}"), setting

    def _describe(self, place: int) -> str:
        test = self.tried[place]
        verdict = "is inconclusive, which counts as failing" if test.verdict == "inconclusive" else test.verdict
        return f"{self.search.settings[place].label} {verdict} ({describe(test)})"

    def _finding(self, state: SearchState, setting: PluginSetting | None, words: str) -> SearchFinding:
        label = setting.label if setting is not None else ""
        words += f"; {len(self.tried)} of {len(self.search.settings)} settings tried" if state != "under way" else ""
        codec = self.search.settings[0].name
        return SearchFinding(self.sequence, codec, PASSES, state, label, None, len(self.tried), words)
