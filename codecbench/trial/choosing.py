"""Which settings are good enough over a link, of a run or of a matrix that is run for it: `codecbench.choose`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from codecbench.core.analysis import collect
from codecbench.core.analysis.choosing import Candidate, Demand, candidates
from codecbench.core.contracts.errors import ParamsError
from codecbench.core.engine.plugins.registry import installed
from codecbench.core.rounds import running
from codecbench.trial.link_matrix import link_matrix

MINUTES: Final = 10.0
"""How long repeats are added that are to tell more."""
_MATRICES: Final = (".yaml", ".yml", ".json")


def is_matrix(source: str | Path | Mapping[str, Any]) -> bool:
    """Whether something is a matrix and not a run folder."""
    return isinstance(source, Mapping) or Path(source).is_file() or Path(source).suffix in _MATRICES


def choose(
    source: str | Path | Mapping[str, Any],
    *,
    link: str,
    deadline_ms: float | None = None,
    error_m: float | None = None,
    share: float = 0.95,
    device_factor: float | None = None,
    out: str | Path | None = None,
    workers: int | None = None,
    minutes: float = MINUTES,
) -> list[Candidate]:
    """Every codec setting over a link in order of rate, judged; with several sequences those of all come first.

    source: a run folder, or a matrix, a file or as a dict, of which is run what it takes; evaluators that it lacks are
    added. out, workers: as of `codecbench.run`. minutes: repeats that are to tell more begin only within that time.
    What is asked: in at least `share` of the frames an age of at most `deadline_ms`, and an error of at most
    `error_m`; of a matrix one of the two at least. device_factor: how many times slower the device encodes than the
    machine that timed it. Raises ParamsError where nothing is asked of a matrix, CodecbenchError where nothing was
    measured, PluginError for a link that is not known, MatrixError and StoreError.
    """
    demand = Demand(link, deadline_ms, error_m, share, device_factor)
    if not is_matrix(source):
        return candidates(collect.open_nonempty_run(Path(str(source))), demand)
    if deadline_ms is None and error_m is None:
        raise ParamsError("say what is asked: deadline_ms, error_m or both")
    made = link_matrix(source if isinstance(source, Mapping) else Path(source), demand, installed())
    summary = running.run_matrix(made.matrix, out, workers=workers, minutes=minutes)
    return candidates(collect.open_nonempty_run(summary.folder), made.demand)
