"""Figures of runs whose values are known: axes, order, bars and colors."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.axes import Axes
from measured_runs import cell_result, run_of
from report_runs import report_run

from codecbench.core.analysis.run_result import RunResult
from codecbench.core.report.figures import curve_figure, draw_all, map_figures
from codecbench.core.report.views import curve_views, styles_of


def run_with(drifts: dict[str, list[tuple[float, float]]], repeats: int = 1) -> RunResult:
    """A run of codecs with (bits, drift) of each setting, in the order of their settings."""
    cells = []
    for codec, settings in drifts.items():
        for q, (bits, drift) in enumerate(settings):
            cells.append(cell_result(codec, float(q), "look", own={("bits", ""): [bits]}))
            for repeat in range(repeats):
                own = {("drift", ""): [drift * (1 + 0.1 * repeat)]}
                cells.append(cell_result(codec, float(q), "track", own=own, repeat=repeat))
    return run_of(*cells)


def drawn(drifts: dict[str, list[tuple[float, float]]], repeats: int = 1) -> tuple[RunResult, Axes]:
    """The axes of drift over bits, and the run."""
    run = run_with(drifts, repeats)
    (view,) = (view for view in curve_views(run) if view.y.metric.name == "drift" and view.x == run.rate)
    figure = curve_figure(run, run.plan.sequences[0], view)
    assert figure is not None
    figure.canvas.draw()
    return run, figure.axes[0]


@pytest.mark.parametrize("values", [(6.3, 7.1), (0.9, 5.5), (0.001, 800.0), (1e-9, 1e9)])
def test_a_logarithmic_axis_is_numbered_wherever_its_values_lie(values: tuple[float, float]) -> None:
    _, axes = drawn({"plain": [(1.0, values[0]), (2.0, values[1])]})
    low, high = axes.get_ylim()
    numbers = [
        text.get_text() for text, at in zip(axes.get_yticklabels(), axes.get_yticks(), strict=True) if low <= at <= high
    ]
    assert 3 <= len([number for number in numbers if number]) <= 9
    plt.close("all")


def test_settings_are_joined_in_their_order_and_repeats_have_bars() -> None:
    """The second setting takes more bits than the third."""
    run, axes = drawn({"plain": [(1.0, 3.0), (3.0, 2.0), (2.0, 1.0)], "other": [(1.0, 4.0), (2.0, 2.0)]}, repeats=5)
    lines = {container.get_label(): container for container in axes.containers}
    np.testing.assert_array_equal(lines["plain"].lines[0].get_xdata(), [1.0, 3.0, 2.0])
    assert lines["plain"].lines[0].get_color() == styles_of(run)["plain"].color
    (bars,) = lines["plain"].lines[2]
    for (low, high), middle in zip(
        (segment[:, 1] for segment in bars.get_segments()), lines["plain"].lines[0].get_ydata(), strict=True
    ):
        assert low < middle < high
    plt.close("all")


def test_the_baseline_is_a_level_line_with_a_band_and_takes_no_room() -> None:
    run, axes = drawn({"raw": [(24.0, 0.5)], "plain": [(1.0, 3.0), (2.0, 1.0)]}, repeats=5)
    assert axes.get_xlim()[1] < 3.0
    (level,) = (line for line in axes.lines if len(set(line.get_xdata())) == 2 and line.get_xdata()[0] == 0.0)
    assert level.get_color() == styles_of(run)["raw"].color
    (band,) = axes.patches
    assert band.get_y() < level.get_ydata()[0] < band.get_y() + band.get_height()
    _, alone = drawn({"raw": [(24.0, 0.5)]})
    assert alone.get_xlim()[0] < 24.0 < alone.get_xlim()[1]
    plt.close("all")


@pytest.mark.parametrize(("last", "figures"), [(2.0, 0), (1.0, 1)])
def test_a_metric_that_is_the_same_for_all_codecs_is_not_drawn(tmp_path: Path, last: float, figures: int) -> None:
    run = run_with({"raw": [(24.0, 2.0)], "plain": [(1.0, 2.0), (2.0, last)]})
    assert len([path for path in draw_all(run, tmp_path) if "drift" in path.name]) == figures


def test_maps_say_their_unit() -> None:
    _, figure = next(map_figures(report_run(1)))
    assert (figure.axes[0].get_xlabel(), figure.axes[0].get_ylabel()) == ("x [m]", "y [m]")
    plt.close("all")
