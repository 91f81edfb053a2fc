"""One figure of a run, found by words."""

from __future__ import annotations

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from codecbench.core.contracts.errors import ParamsError
from codecbench.core.results.answers import judged_column
from codecbench.core.results.columns import Column
from codecbench.core.results.figures import STYLE, curve_figure
from codecbench.core.results.run_result import RunResult
from codecbench.core.results.views import CurveView, curve_views


def one_figure(run: RunResult, what: str = "", sequence: str | None = None) -> Figure:
    """See `RunResult.plot`."""
    views, names = curve_views(run), [entry.name for entry in run.plan.sequences]
    if sequence is not None and sequence not in names:
        raise ParamsError(f"the run has no sequence {sequence!r}; it has {', '.join(names)}")
    judged = judged_column(run)
    across, _, up = what.partition("-")
    wanted = [view for view in views if _means(view.x, across) and _means(view.y, up)]
    if not what:
        wanted = [view for view in views if view.x == run.rate and view.y == judged]
    for entry in run.plan.sequences:
        if sequence in (None, entry.name):
            for view in wanted:
                with plt.rc_context(STYLE):
                    figure = curve_figure(run, entry, view)
                if figure is not None:
                    plt.close(figure)  # the caller's alone: pyplot would show it a second time in a notebook
                    return figure
    there = ", ".join(dict.fromkeys(_spelling(view) for view in views))
    raise ParamsError(f"no figure {what!r} of {sequence or 'any sequence'}; there are {there or 'none'}")


def _means(column: Column, word: str) -> bool:
    """Whether the word is in what the column is called."""
    return word.lower() in f"{column.metric.name} {column.label} {column.metric.brief} {column.metric.role}".lower()


def _spelling(view: CurveView) -> str:
    return f"{view.x.metric.name}-{view.y.metric.name}"
