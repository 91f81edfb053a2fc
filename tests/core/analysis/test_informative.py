"""A metric ranks codecs on a sequence only where raw beats the coarsest settings and finer settings are better."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from measured_runs import cell_result, run_of
from told import numbers

from codecbench.core.analysis.ranking import Ranking, rankings
from codecbench.core.analysis.table import CellResult
from codecbench.core.contracts.errors import ParamsError
from codecbench.core.facade import Run
from codecbench.core.report.answers import answers
from codecbench.core.report.formatting import verdicts

RATES = (0.25, 0.5, 1.0, 2.0)
FACTORS = {"plain": 1.0, "good": 0.5, "bad": 2.0}
Errors = Callable[[float, float], float]


def cells(errors: Errors, raw: float | None, sequence: str = "s", spread: float = 0.05) -> list[CellResult]:
    """Three codecs that have such errors by factor and rate, and the raw codec, over 12 repeats with noise."""
    rng = np.random.default_rng(5)
    settings = [(codec, rate, errors(factor, rate)) for codec, factor in FACTORS.items() for rate in RATES]
    settings += [] if raw is None else [("raw", 24.0, raw)]
    made = []
    for codec, rate, error in settings:
        made.append(cell_result(codec, rate, "size", own={("bits", ""): [rate]}, sequence_name=sequence))
        for repeat in range(12):
            own = {("drift", ""): [error * float(np.exp(rng.normal(0.0, spread)))]}
            made.append(cell_result(codec, rate, "track", own=own, repeat=repeat, sequence_name=sequence))
    return made


def falling(factor: float, rate: float) -> float:
    return factor / rate


def saturated(factor: float, rate: float) -> float:
    """Lost at the coarsest setting, and alike from there on: what is left is noise."""
    return 5.0 * factor if rate == RATES[0] else 1.0


def rising(factor: float, rate: float) -> float:
    return factor * rate


def chance(factor: float, rate: float) -> float:
    return {0.25: 1.0, 0.5: 1.6, 1.0: 0.8, 2.0: 1.2}[rate] * factor


def test_a_metric_that_is_in_order_ranks() -> None:
    (found,) = rankings(run_of(*cells(falling, 0.1)))
    assert [ranked.curve for ranked in found.ranked] == ["good", "plain", "bad"]
    assert found.uninformative == {}


def test_noise_of_settings_that_are_all_good_enough_does_not_silence_it() -> None:
    (found,) = rankings(run_of(*cells(saturated, 1.0, spread=0.2)))
    assert (len(found.ranked), found.uninformative) == (3, {})


@pytest.mark.parametrize(
    ("errors", "raw", "spread", "words", "values"),
    [
        (lambda *_: 0.3, 0.3, 0.0, "equal values", []),
        (lambda factor, _: factor, 0.3, 0.0, "equal values", []),
        (falling, 9.0, 0.0, "raw (9) is", [9.0, 4.0]),
        (rising, 0.01, 0.0, "finer settings", [100.0]),
        (rising, None, 0.0, "finer settings", [100.0]),
        (chance, 0.01, 0.05, "finer settings", [46.0]),
    ],
    ids=["constant", "constant of each codec", "raw worse than the coarsest", "reverse", "without raw", "chance"],
)
def test_a_metric_that_is_not_in_order_ranks_no_codec_and_has_the_reason(
    errors: Errors, raw: float | None, spread: float, words: str, values: list[float]
) -> None:
    run = run_of(*cells(errors, raw, spread=spread))
    (found,) = rankings(run)
    assert (found.sequence, found.ranked, found.pairs) == ("s", (), ())
    reason = found.uninformative["s"]
    assert words in reason
    assert numbers(reason) == values
    (verdict,) = verdicts(run)
    assert (verdict.title, verdict.rows, verdict.sentences) == ("s: drift", (), (f"Uninformative here: {reason}.",))
    said = str(answers(run))
    assert said.startswith("Nothing can be recommended")
    assert said.endswith(f": {reason}.")
    assert rankings(run, at=1.0)[0].ranked == ()
    with pytest.raises(ParamsError, match="s: drift is uninformative"):
        run.best(1.0)
    with pytest.raises(ValueError, match="empty"):
        _ = found.recommended


def two(first: list[CellResult], second: list[CellResult]) -> tuple[Run, dict[str, Ranking]]:
    run = run_of(*first, *second)
    return run, {ranking.sequence: ranking for ranking in rankings(run)}


def test_a_sequence_on_which_it_is_not_does_not_count_for_all() -> None:
    run, found = two(cells(falling, 0.1, "s"), cells(rising, 0.1, "t"))
    alone = rankings(run_of(*cells(falling, 0.1, "s")))[0]
    assert (
        [each.curve for each in found[""].ranked] == [each.curve for each in alone.ranked] == ["good", "plain", "bad"]
    )
    assert (found[""].pairs, found[""].units) == (alone.pairs, alone.units)
    assert (found["s"].ranked, found["s"].uninformative) == (alone.ranked, {})
    assert found["t"].ranked == ()
    assert found[""].uninformative == found["t"].uninformative
    assert list(found["t"].uninformative) == ["t"]
    together = verdicts(run)[0]
    assert [said for said in together.sentences if said.startswith("t: drift is uninformative")]


def test_where_no_sequence_is_informative_the_verdict_says_so_of_each() -> None:
    run, found = two(cells(rising, 0.1, "s"), cells(falling, 9.0, "t"))
    assert {name: each.ranked for name, each in found.items()} == {"": (), "s": (), "t": ()}
    assert [said.split(" is ")[0] for said in verdicts(run, brief=True)[0].sentences] == ["s: drift", "t: drift"]


def test_settings_without_a_value_are_no_reason_against_other_sequences() -> None:
    nothing = [cell_result(codec, rate, "size", own={("bits", ""): [rate]}, sequence_name="t")
               for codec in FACTORS for rate in RATES]  # fmt: skip
    nothing += [cell_result(codec, rate, "track", own={("drift", ""): [float("nan")]}, repeat=repeat, sequence_name="t")
                for codec in FACTORS for rate in RATES for repeat in range(12)]  # fmt: skip
    _, found = two(cells(falling, 0.1, "s"), nothing)
    assert [each.curve for each in found[""].ranked] == ["good", "plain", "bad"]
    assert list(found[""].uninformative) == ["t"]
    assert found[""].uninformative["t"].startswith("no setting has")


def test_codecs_of_one_setting_say_nothing_of_a_metric() -> None:
    """Codecs without loss are alike, and smaller is better."""
    made = []
    for codec, rate in (("plain", 4.0), ("good", 3.0), ("raw", 8.0)):
        made.append(cell_result(codec, rate, "size", {("bits", ""): [rate] * 12}, count=12))
        made.append(cell_result(codec, rate, "track", {("drift", ""): [1.0] * 12}, count=12))
    (found,) = rankings(run_of(*made))
    assert ([ranked.curve for ranked in found.ranked], found.uninformative) == (["good", "plain"], {})
