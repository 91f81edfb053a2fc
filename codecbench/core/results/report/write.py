"""Writes a report in one of its formats."""

from __future__ import annotations

from collections.abc import Collection
from functools import partial
from pathlib import Path

from codecbench.core.contracts.errors import ParamsError
from codecbench.core.engine.storage.atomic import write_file
from codecbench.core.results.export import exported, short_table
from codecbench.core.results.report.pictures import frame_pictures
from codecbench.core.results.report.render import render
from codecbench.core.results.run_result import RunResult
from codecbench.core.results.table import NOTES


def write_report(
    run: RunResult,
    path: Path,
    format_: str = "html",
    *,
    sequences_from: str | None = None,
    frames: Collection[int] = (),
) -> int:
    """Write the report of a run and return its size in bytes.

    `html`: the whole page. `markdown` or `md`, `latex`: the short table, for a pull request or a paper, with what is
    noted of settings as its last column. sequences_from:
    where the frames are that the page shows, a folder or `same` for where the plan says; None shows them only of a run
    that was made here. frames: numbers of the frames to show, from 0; by default a few. Raises ParamsError for another
    format, and for a frame that no sequence has.
    """
    longest = max((entry.frames for entry in run.plan.sequences), default=0)
    if beyond := [number for number in frames if not 0 <= number < longest]:
        raise ParamsError(f"frame {beyond[0]} is in no sequence of the run; they have frames 0 to {longest - 1}")
    if format_ == "html":
        content = render(run, partial(frame_pictures, run, sequences_from=sequences_from, wanted=frames)).encode()
    elif format_ in ("markdown", "md", "latex"):
        table = short_table(run).join(run.wide.filter([NOTES]))
        content = exported(table, "latex" if format_ == "latex" else "markdown")
    else:
        raise ParamsError(f"format {format_!r} is not one of html, markdown, latex")
    write_file(path, content)
    return len(content)
