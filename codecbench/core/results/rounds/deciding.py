"""Which repeats of a setting are needed until it is decided whether more than half of all runs would do."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable

from codecbench.core.engine.planning.aim import Aim
from codecbench.core.engine.planning.model import PluginSetting
from codecbench.core.results.limits import Holding
from codecbench.core.results.rounds.sequential import runs_to_make, verdict
from codecbench.core.results.rounds.trials import CellKey, Trials, column_of
from codecbench.core.results.run_result import RunResult
from codecbench.core.results.table import CellResult
from codecbench.core.results.verdicts import values_in


def repeats_to_decide(
    run: RunResult, trials: Trials, aim: Aim, most: int, settings: Iterable[tuple[str, PluginSetting]]
) -> dict[CellKey, int]:
    """How many repeats of an evaluator each setting on a sequence is to have, at most `most`.

    The baseline has all: others are judged beside it. Of a curve, from the most rate down, repeats are added as far as
    the first setting that fails, because a limit is where all above it hold. A live error has no such limit, for what
    is too large for a link comes too late, and is judged by itself: so each setting is decided, the baseline too.
    """
    each = aim.metric.need == "error"
    found: dict[CellKey, int] = {}
    curves: dict[tuple[str, str], list[tuple[float, CellKey]]] = defaultdict(list)
    for sequence, setting in settings:
        key = sequence, setting, aim.evaluator.title
        if setting.name in run.meaning.baselines and not each:
            found[key] = most
            continue
        place = (setting.name, setting.label)
        rate = run.rates.get((sequence, *place), math.nan)
        curve = run.curves[place].curve if place in run.curves else " ".join(place)
        curves[sequence, curve].append((math.inf if math.isnan(rate) else rate, key))
    for members in curves.values():
        failed_at = -math.inf
        for rate, key in sorted(members, key=lambda member: -member[0]):
            recorded = trials.recorded(*key)
            count, said = needed(recorded, aim, most)
            below = rate < failed_at and not each
            found[key] = max(runs_to_make(0, 0, most), len(recorded)) if below else count
            if said == "fails" and math.isfinite(rate):
                failed_at = max(failed_at, rate)
    return found


def needed(recorded: list[CellResult], aim: Aim, most: int) -> tuple[int, Holding]:
    """How many repeats a setting is to have, and what those that it has say.

    A repeat that has no value says nothing, one without a result does not do. Where none of the first says anything,
    more would not.
    """
    column = column_of(aim)
    count = runs_to_make(0, 0, most)
    while len(recorded) >= count:
        outcomes = [_outcome(result, aim, values_in(result, column)[:1]) for result in recorded[:count]]
        judged = [outcome for outcome in outcomes if outcome is not None]
        said = verdict(sum(judged), len(judged), len(judged) if count >= most else most)
        if said != "cannot tell" or count >= most or not judged:
            return max(count, len(recorded)), said
        count = min(most, count + runs_to_make(sum(judged), len(judged), most) - len(judged))
    return count, "cannot tell"


def _outcome(result: CellResult, aim: Aim, values: list[float]) -> bool | None:
    """Whether a repeat will do; None where it says nothing."""
    if result.status == "unsupported":
        return None
    if result.status != "ok" or not values:
        return False
    return None if math.isnan(values[0]) else aim.met_by(values[0])
