"""Writes a report in one of its formats."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from codecbench.core.contracts.errors import ParamsError
from codecbench.core.engine.storage.atomic import write_file
from codecbench.core.results.export import exported, short_table
from codecbench.core.results.report.pictures import frame_pictures
from codecbench.core.results.report.render import render
from codecbench.core.results.run_result import RunResult


def write_report(run: RunResult, path: Path, format_: str = "html", *, sequences_from: str | None = None) -> int:
    """Write the report of a run and return its size in bytes.

    `html`: the whole page. `md`, `latex`: the short table, for a pull request or a paper. sequences_from: where the
    frames are that the page shows, a folder or `same` for where the plan says; None shows them only of a run that was
    made here. Raises ParamsError for another format.
    """
    if format_ == "html":
        content = render(run, partial(frame_pictures, run, sequences_from=sequences_from)).encode()
    elif format_ in ("md", "latex"):
        content = exported(short_table(run), "markdown" if format_ == "md" else "latex")
    else:
        raise ParamsError(f"format {format_!r} is not one of html, md, latex")
    write_file(path, content)
    return len(content)
