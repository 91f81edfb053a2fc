"""The page that compares the paper with our runs."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from codecbench.core.analysis.limits import POOLED, Limit, limits
from codecbench.core.analysis.run_result import RunResult, successes
from codecbench.core.engine.planning.model import PluginSetting
from codecbench.core.engine.storage.atomic import write_file
from codecbench.core.report.figures import draw_all
from codecbench.core.report.tables import change, escape, foreign_table
from codecbench.paper.contradictions import contradictions
from codecbench.paper.measured import CITATION, RAW_RMSE, SUCCEEDS_UP_TO, Measured, paper_table

_DEVIATIONS = (
    "Sizes of the multi-level method: ours code the table of tuples and its counts with adaptive contexts. The paper "
    "does not say how it codes them.",
    "PSNR and SSIM depend on the frames. The paper scores frames 1132 and 2398 of freiburg3_long_office_household, "
    "which are not among ours.",
    "JPEG with a quantization factor: the paper's sizes barely fall with QF (153 to 140 KB), which no entropy coder of "
    "JPEG produces. Ours are those of baseline JPEG files of these coefficients.",
    "JPEG 2000 at equal compression ratio: our frames compress better than the paper's, so PSNR is higher at the same "
    "ratio.",
    "Times are those of compiled kernels on one core, the paper's are MATLAB's.",
    "Trajectories: our ORB-SLAM is deterministic and written from the ORB-SLAM papers; the paper used MATLAB's "
    "example. We report errors after a similarity alignment and, as `ate_rmse_first_frame_m`, the paper's way of "
    "measuring.",
)


def write_page(runs: list[RunResult], path: Path) -> list[Path]:
    """Write the page of one or more runs to `path` and its figures beside it; return all paths written.

    The tables are of the first run; the trajectories are of all runs.
    """
    measured = [Measured(run) for run in runs]
    folder = path.parent / f"{path.stem}-figures"
    figures = [figure for number, run in enumerate(runs) for figure in _draw_figures(run, folder, number)]
    parts = [*_introduction(runs), *contradiction_list(measured), *_frames(runs)]
    parts += [*quality_tables(measured[0]), *operation_tables(measured[0]), *tracking_limits(measured)]
    parts += [*_trajectories(measured)]
    parts += [*_figures(figures, path), *deviations()]
    write_file(path, "\n".join(parts).encode())
    return [path, *figures]


def _draw_figures(run: RunResult, folder: Path, number: int) -> list[Path]:
    """Draw the figures of a run, of each run after the first in a subfolder."""
    return list(draw_all(run, folder / run.plan.name if number else folder, "svg"))


def _introduction(runs: list[RunResult]) -> Iterator[str]:
    yield "# The paper, reproduced and judged\n"
    names = " and ".join(f"`{run.plan.name}`" for run in runs)
    origin = f"Made by `codecbench reproduce` (codecbench {version('codecbench')}) from {names}."
    yield f"{origin} The paper is {CITATION}.\n"
    yield (
        "Nothing is tuned to the paper's figures. Where its numbers cannot be reached or contradict themselves, this "
        "page says so.\n"
    )


def _frames(runs: list[RunResult]) -> Iterator[str]:
    yield "## Frames\n"
    rows = [
        [
            run.plan.name,
            entry.name,
            entry.dataset.name,
            entry.frames,
            "gray" if entry.channels == 1 else "color",
            entry.fingerprint[:12],
        ]
        for run in runs
        for entry in run.plan.sequences
    ]
    yield foreign_table(["run", "sequence", "dataset", "frames", "", "fingerprint"], rows)
    yield "The paper: TUM freiburg3_long_office_household, 2585 frames; its tables show frames 1132 and 2398.\n"
    for run in runs:
        yield _provenance(run)


def _provenance(run: RunResult) -> str:
    """Describe where a run was computed, how much of it, and for how long."""
    machines = sorted({str(environment.get("machine", {}).get("cpu")) for environment in run.environments.values()})
    completed = sum(result.status == "ok" for result in run.results)
    unsupported = sum(result.status == "unsupported" for result in run.results)
    machine = escape(", ".join(machines)) or "an unknown machine"
    rest = f"{len(run.failed)} failed, {unsupported} unsupported"
    hours = sum(result.duration_s for result in run.results) / 3600
    return (
        f"`{run.plan.name}`, computed on {machine}: {completed} of {len(run.plan.cells)} cells, {rest}; "
        f"their evaluation took {hours:.1f} hours of one worker's time.\n"
    )


def tracking_limits(measured: list[Measured]) -> Iterator[str]:
    """Yield a table for each run and trajectory evaluator: the limit of tracking by sequence and curve."""
    if not any(numbers.run.headlines("success") for numbers in measured):
        return
    yield "## How far a codec can go before tracking fails\n"
    yield (
        "A run succeeds if its first map comes at most 30 frames later than with raw frames, if from then on it tracks "
        "at least 90 % of what raw frames' runs track, and if its error is at most twice theirs (medians over all "
        "starts). A setting holds if the 95 % Wilson interval of its success rate lies above one half. The limit is "
        "the least rate down to which every setting holds.\n"
    )
    for run in (numbers.run for numbers in measured):
        tracked = run.tidy[run.tidy["metric"] == "tracked_fraction"].groupby("sequence", observed=True)["value"].max()
        untracked = [str(name) for name, most in tracked.items() if most == 0.0]
        if untracked:
            yield f"Too short for a first map, with every codec and with raw frames: {escape(', '.join(untracked))}.\n"
        for columns in successes(run):
            rows = [
                [sequence, curve, *_limit(limit), _paper(curve)]
                for (sequence, curve), limit in limits(run, columns).items()
                if sequence not in (POOLED, *untracked)
            ]
            if rows:
                yield f"### {run.plan.name}, {escape(columns[0].evaluator.title)}\n"
                heads = ["sequence", "curve", "passes down to", "bpp", "successful runs", "below it", "in the paper"]
                yield foreign_table(heads, rows)


def _limit(limit: Limit) -> list[object]:
    if limit.reason:
        return [limit.reason, None, "", ""]
    lowest = limit.lowest
    if lowest is None:
        return ["–", None, "", limit.after_words()]
    return [lowest.point or "its setting", lowest.rate, str(lowest), limit.after_words()]


def _paper(curve: str) -> str:
    limit = SUCCEEDS_UP_TO.get(curve.split(" ")[0])
    return f"{limit[0]}={limit[1]:g}" if limit else "–"


def _trajectories(measured: list[Measured]) -> Iterator[str]:
    """Yield errors and coverage of every setting side by side, as one without the other misleads."""
    heads = ["ATE [m]", "95 %", "ATE, first frame [m]", "tracked", "loops", "keyframes", "lost"]
    names = ("ate_rmse_m", "ate_rmse_first_frame_m", "tracked_fraction", "loops_closed", "keyframes", "times_lost")
    for run in (numbers.run for numbers in measured):
        for evaluator in (columns[0].evaluator.title for columns in successes(run)):
            rows: list[list[object]] = []
            for row in run.wide.to_dict("records"):
                values = [float(row.get(f"{evaluator}.{name}.median", np.nan)) for name in names]
                if values[2] > 0.0:
                    ends = [float(row.get(f"{evaluator}.ate_rmse_m.ci95_{end}", np.nan)) for end in ("low", "high")]
                    interval = "–" if np.isnan(ends).any() else f"{ends[0]:.3g} to {ends[1]:.3g}"
                    rate = float(row.get("quality.rate_bpp.mean", np.nan))
                    rows.append([row["sequence"], row["codec"], row["setting"], rate, values[0], interval, *values[1:]])
            if rows:
                yield f"### Trajectories of {run.plan.name}, {escape(evaluator)}\n"
                yield foreign_table(["sequence", "codec", "setting", "bpp", *heads], rows)
    yield f"The paper gives {RAW_RMSE} for raw frames, without a unit, over the whole sequence with its loop.\n"


def _figures(figures: list[Path], page: Path) -> Iterator[str]:
    if figures:
        yield "## Figures\n"
        yield "Figures 7 to 11 of the paper are the trajectories, Figure 12 the operations.\n"
        for path in figures:
            yield f"![{path.stem.replace('-', ', ').replace('_', ' ')}]({path.relative_to(page.parent)})\n"


def contradiction_list(measured: list[Measured]) -> Iterator[str]:
    """Yield the paper's contradictions, and our measurements of each."""
    yield "## Where the paper contradicts itself\n"
    for number, (title, statement, measurements) in enumerate(contradictions(measured), start=1):
        yield f"{number}. **{title}.** {statement} Found:\n"
        yield "\n".join(f"    - {measurement}" for measurement in measurements) + "\n"


def deviations() -> Iterator[str]:
    """Yield what differs from the paper, and why."""
    yield "## Deviations and their causes\n"
    yield "\n".join(f"- {line}" for line in _DEVIATIONS) + "\n"


_PSNR = "quality.psnr_gray_db.mean"
_SSIM = "quality.ssim_matlab.mean"
_CR = "quality.cr_percent.mean"
_CLASSES = ("mults", "adds", "bit_ops", "comparisons", "shifts", "reads", "writes")


def quality_tables(measured: Measured) -> Iterator[str]:
    """Yield Tables 1, 2 and 3: size, quality, compression ratio and time at the paper's settings on each sequence."""
    yield "## Table 1: JPEG with a quantization factor\n"
    yield _size_table(measured, "jpeg_qf", "qf", paper_table("table1_jpeg"), {})
    yield "## Table 2: JPEG 2000\n"
    yield _size_table(measured, "jpeg2000", "cr_percent", paper_table("table2_jpeg2000"), {})
    paper = paper_table("table3_multilevel")
    for levels in (1, 2):
        renamed = paper.rename(
            columns={f"l{levels}_{name}": name for name in ("size_kb", "cr_percent", "encode_s", "decode_s")}
        )
        yield f"## Table 3: multi-level, {'one level' if levels == 1 else 'two levels'}\n"
        yield _size_table(measured, "multilevel", "qf", renamed, {"levels": levels})


def _size_table(measured: Measured, codec: str, key: str, paper: pd.DataFrame, fixed: dict[str, Any]) -> str:
    heads = [
        key, "", "size [KiB]", "against the paper", "PSNR [dB]", "SSIM", "CR [%]", "encode [ms]", "decode [ms]",
    ]  # fmt: skip
    rows: list[list[Any]] = []
    for value, group in paper.groupby(key, sort=True):
        mean_kib = float(group["size_kb"].mean())
        setting = measured.setting(codec, **{key: value}, **fixed)
        rows += [[value, *_paper_columns(row)] for row in group.to_dict("records")]
        rows += [
            [value, f"ours, {name}", *_our_columns(measured, name, setting, mean_kib)] for name in measured.sequences
        ]
    return foreign_table(heads, rows)


def _paper_columns(row: dict[Any, Any]) -> list[Any]:
    quality = [row["psnr_db"], row["ssim"], row.get("cr_percent")]
    return [
        f"paper, frame {row['frame']}",
        row["size_kb"],
        "",
        *quality,
        1000 * row["encode_s"],
        1000 * row["decode_s"],
    ]


def _our_columns(measured: Measured, sequence: str, setting: PluginSetting | None, paper_kib: float) -> list[Any]:
    size = measured.size_kib(sequence, setting)
    values = [measured.value(sequence, setting, column) for column in (_PSNR, _SSIM, _CR)]
    times = [measured.value(sequence, setting, f"timing.{way}_wall_ms.median") for way in ("encode", "decode")]
    return [size, change(size, paper_kib), *values, *times]


def operation_tables(measured: Measured) -> Iterator[str]:
    """Yield Tables 4, 5 and 6: operation counts of the paper, of its formulas, and of our kernels."""
    paper = paper_table("table456_operations")
    settings = {
        4: measured.setting("jpeg_qf", qf=5),
        5: measured.setting("jpeg2000", cr_percent=73),
        6: measured.setting("multilevel", qf=5, levels=1, decoding="search")
        or measured.setting("multilevel", qf=5, levels=1),
    }
    for number, setting in settings.items():
        stated = paper[paper["table"] == number]
        yield f"## Table {number}: operations of {stated['codec'].iloc[0]}\n"
        rows = [
            [f"paper, {row['direction']} {row['stage']}", *(row[name] for name in _CLASSES), row["total"]]
            for row in stated.to_dict("records")
        ]
        rows += _operation_rows(measured, setting)
        yield foreign_table(["stage", *(name.replace("_", " ") for name in _CLASSES), "total"], rows)


def _operation_rows(measured: Measured, setting: PluginSetting | None) -> list[list[Any]]:
    """Return our totals by family and direction on each sequence; opaque codecs have no source counts."""
    rows: list[list[Any]] = []
    for sequence in measured.sequences:
        for family in ("model", "source", "machine"):
            for direction in ("encode", "decode"):
                columns = [f"operations.{family}_{name}.{direction}.mean" for name in (*_CLASSES, "total")]
                values = [measured.value(sequence, setting, column) for column in columns]
                if any(value == value for value in values):
                    rows.append([f"ours, {family}, {direction}, {sequence}", *values])
    return rows
