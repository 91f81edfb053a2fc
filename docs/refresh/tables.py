"""The tables of the pages, one function each: of runs, of what a script printed, or of what the code declares."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tempfile
import textwrap
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.stats import spearmanr

from codecbench.core.analysis.ranking import rankings
from codecbench.core.analysis.run_result import RunResult
from codecbench.core.contracts.metric import Metric
from codecbench.core.engine.registry import installed
from codecbench.core.report.formatting import signed_percent
from codecbench.core.report.tables import cell, table
from codecbench.plugins.datasets.synthetic.worlds.conditions import moved
from codecbench.plugins.datasets.synthetic.worlds.presets import WORLDS

IMAGES: Final = Path(__file__).parents[1] / "images"
Row = dict[str, Any]
RunTable = Callable[..., Iterator[str]]


@dataclass(frozen=True)
class Column:
    """A column of the wide table, times a factor, to three decimals."""

    name: str
    factor: float = 1.0

    def shown(self, row: Row) -> str:
        value = float(row.get(self.name, np.nan)) * self.factor
        return cell(round(value, 3) if np.isfinite(value) else value)


RATE: Final = {"bit/px": Column("quality.rate_bpp.mean")}
PSNR: Final = {"PSNR dB": Column("quality.psnr_gray_db.mean")}
CODING: Final = RATE | {
    "CR vs PNG %": Column("quality.cr_percent.mean"),
    **PSNR,
    "SSIM": Column("quality.ssim_matlab.mean"),
    "features kept": Column("features.keypoint_repeatability.mean"),
    "search ms": Column("timing.prepare_cpu_ms.median"),
    "encode ms": Column("timing.encode_cpu_ms.median"),
    "decode ms": Column("timing.decode_cpu_ms.median"),
    "counted Mops": Column("operations.source_total.encode.mean", 1e-6),
    "paper's model Mops": Column("operations.model_total.encode.mean", 1e-6),
}
TASKS: Final = RATE | {
    "localisation AUC": Column("localization.located_auc.mean"),
    "map points found": Column("localization.tracked_inliers.mean"),
    "held mm": Column("trajectory.held_ate_m.median", 1e3),
    "ATE mm": Column("trajectory.ate_rmse_m.median", 1e3),
    "device ms": Column("timing.encode_cpu_ms.median"),
    "of which extracting": Column("timing.encode_cpu_ms.encode/extract.median"),
    "server ms": Column("timing.decode_cpu_ms.median"),
}
JOINING: Final = {
    "kbit/s": Column("stream.bitrate_kbps.mean"),
    **PSNR,
    "largest frame, bytes": Column("stream.largest_frame_bytes.mean"),
    "joining, frames": Column("stream.joining_frames.mean"),
    "worst, frames": Column("stream.joining_worst_frames.mean"),
}
PATHS: Final = {
    "tracked": Column("trajectory.tracked_fraction.median"),
    "ATE mm": Column("trajectory.ate_rmse_m.median", 1e3),
    "95 % from": Column("trajectory.ate_rmse_m.ci95_low", 1e3),
    "to": Column("trajectory.ate_rmse_m.ci95_high", 1e3),
    "runs that succeed": Column("trajectory.success.mean"),
}


def settings(columns: dict[str, Column], sequence: str = "") -> RunTable:
    """One row for each setting on a sequence, by default a run's only one."""

    def content(run: RunResult) -> Iterator[str]:
        (entry,) = [entry for entry in run.plan.sequences if sequence in ("", entry.name)]
        rows = [{str(k): v for k, v in row.items()} for row in run.wide.to_dict("records")]
        cells = [
            [row["codec"], row["setting"], *(column.shown(row) for column in columns.values())]
            for row in rows
            if row["sequence"] == entry.name
        ]
        yield f"{entry.frames} frames of {entry.name}:\n"
        yield table(["codec", "setting", *columns], cells)

    return content


def paths(run: RunResult) -> Iterator[str]:
    """One row for each sequence and setting, of `trajectory`."""
    heads = ("sequence", "codec", "setting")
    rows = [{str(k): v for k, v in row.items()} for row in run.wide.to_dict("records")]
    cells = [[*(row[head] for head in heads), *(column.shown(row) for column in PATHS.values())] for row in rows]
    yield table([*heads, *PATHS], cells)


def order(*anchors: str) -> RunTable:
    """Codecs in order of each task over all sequences, with their rates vs. anchors."""

    def content(run: RunResult) -> Iterator[str]:
        rows = []
        for ranking in rankings(run, brief=True):
            for ranked in ranking.ranked:
                beside = [ranking.evidence(ranked.curve, anchor) for anchor in anchors]
                saved = ["–" if evidence is None else signed_percent(evidence) for evidence in beside]
                rows.append([ranking.column.label, ranked.curve, *saved, ", ".join(ranked.ahead_of) or "–"])
        yield table(["task", "codec", *(f"rate vs. {anchor}" for anchor in anchors), "better than"], rows)

    return content


def answer(run: RunResult) -> Iterator[str]:
    """The figure of localization in the office, and the rates of codecs vs. JPEG over all sequences."""
    with tempfile.TemporaryDirectory() as folder:
        command("plot", str(run.folder), "--out", folder)
        shutil.copy(Path(folder) / "office-rate-located_auc.svg", IMAGES / "localization.svg")
    ranking = next(each for each in rankings(run, brief=True) if each.column.name == "localization.located_auc.mean")
    rows = []
    for ranked in ranking.ranked:
        evidence = ranking.evidence(ranked.curve, "jpeg")
        if evidence and all(len(each) > 1 for each in ranked.settings.values()):
            better = "yes" if "jpeg" in ranked.ahead_of else "not shown"
            rows.append([f"`{ranked.curve.partition(' ')[0]}`", signed_percent(evidence), better])
    yield "![Localization over the rate, one line a codec](docs/images/localization.svg)\n"
    names = ", ".join(entry.name for entry in run.plan.sequences)
    yield f"Rate vs. JPEG for equal localization, over {len(run.plan.sequences)} sequences ({names}):\n"
    yield table(["codec", "rate vs. JPEG", "significantly better"], rows)


def followers(run: RunResult) -> Iterator[str]:
    """Spearman correlation of the means of cheaper metrics with those of tasks, over lossy settings."""
    tasks = {
        "localisation AUC": "localization.located_auc", "map points found": "localization.tracked_inliers",
        "relative pose AUC": "relative_pose.pose_auc_10deg", "correct matches": "relative_pose.correct_matches",
    }  # fmt: skip
    cheaper = {
        "PSNR": "quality.psnr_gray_db", "SSIM": "quality.ssim_matlab",
        "features kept, the SLAM's ORB": "features.keypoint_repeatability",
        "matches kept, the SLAM's ORB": "features.matches_kept",
        "features kept, OpenCV's ORB": "features.opencv_keypoint_repeatability",
        "matches kept, OpenCV's ORB": "features.opencv_matches_kept",
    }  # fmt: skip
    lossy = run.wide[np.isfinite(run.wide["quality.psnr_gray_db.mean"])]
    rows = []
    for label, metric in cheaper.items():
        pairs = [(lossy[f"{metric}.mean"], lossy[f"{task}.mean"]) for task in tasks.values()]
        rows.append([label, *(f"{float(spearmanr(a, b, nan_policy='omit').statistic):.3f}" for a, b in pairs)])
    yield table(["metric", *tasks], rows)
    yield f"{len(lossy)} lossy settings of {lossy['codec'].nunique()} codecs on {run.plan.sequences[0].frames} frames."


def chosen_over_link(run: RunResult) -> Iterator[str]:
    """What `codecbench choose` says over a telemetry radio, without its headings."""
    words = ("--link", "telemetry_900mhz", "--error", "35cm", "--all", "--format", "markdown")
    yield re.sub(r"^### .*\n\n", "", command("choose", str(run.folder), *words), flags=re.MULTILINE).strip()


def command(*words: str) -> str:
    """What a command of codecbench prints."""
    done = subprocess.run([sys.executable, "-m", "codecbench", *words], stdout=subprocess.PIPE, text=True, check=True)
    return done.stdout


def ended(line: str, shown: str) -> Callable[[str], Iterator[str]]:
    """The part that a pattern finds in what a command of README.md printed, and how long that command took."""

    def content(text: str) -> Iterator[str]:
        (entry,) = [entry for entry in json.loads(text) if line in entry["command"]]
        minutes, seconds = divmod(round(entry["seconds"]), 60)
        (part,) = re.findall(shown, entry["output"], re.DOTALL)
        lines = [textwrap.wrap(line, 90, subsequent_indent="  ") or [""] for line in part.strip().splitlines()]
        yield f"It took {minutes} min {seconds} s and printed:\n"
        yield "\n".join(["```text", *chain(*lines), "```"])

    return content


def printed(*heads: str) -> Callable[[str], Iterator[str]]:
    """The rows of a table with as many columns that a script printed, among whatever else it said."""

    def content(text: str) -> Iterator[str]:
        rows = [row for row in re.findall(r"\| .* \|$", text, re.MULTILINE) if row.count(" | ") == len(heads) - 1]
        head = "| " + " | ".join(heads) + " |"
        if not (rows := [row for row in rows if row != head]):
            raise SystemExit(f"nothing printed is a row of {len(heads)} columns: {head}")
        yield table(heads, []) + "\n".join(rows)

    return content


def coding_times(text: str) -> Iterator[str]:
    """Medians of encoding and decoding a frame, of what pytest-benchmark wrote."""
    ms: dict[str, dict[str, float]] = {}
    titles: dict[str, str] = {}
    for benchmark in benchmarks_of(text, "test_codecs"):
        codec, picture = benchmark["params"]["codec"], benchmark["params"]["picture"]
        if setting := benchmark["extra_info"].get("setting"):
            titles[codec] = f"`{codec}`, {setting}"
        way = benchmark["name"].partition("[")[0].removeprefix("test_")
        ms.setdefault(codec, {})[f"{picture} {way}"] = 1e3 * benchmark["stats"]["median"]
    heads = [f"{picture} {way}" for picture in ("gray", "rgb") for way in ("encode", "decode")]
    rows = [[titles.get(codec, f"`{codec}`"), *(round(each[h], 2) for h in heads)] for codec, each in ms.items()]
    yield table(["codec", *(f"{head} ms" for head in heads)], rows)


def evaluator_times(text: str) -> Iterator[str]:
    """Medians of what pytest-benchmark wrote, of one unit where a benchmark says of how many its time is."""
    rows = []
    for benchmark in benchmarks_of(text, "test_evaluators"):
        title = benchmark["name"].partition("[")[0].removeprefix("test_").replace("_", " ")
        title += f", {benchmark['param']}" if benchmark["param"] else ""
        each_ms = 1e3 * benchmark["stats"]["median"] / benchmark["extra_info"].get("units", 1)
        rows.append([title, f"{cell(float(f'{each_ms:.3g}'))} ms"])
    yield table(["evaluators", "median"], rows)


def benchmarks_of(text: str, file: str) -> list[dict[str, Any]]:
    return [entry for entry in json.loads(text)["benchmarks"] if f"/{file}.py::" in f"/{entry['fullname']}"]


def conditions() -> Iterator[str]:
    """What severity moves in each world."""
    rows = []
    for name, world in WORLDS.items():
        scaled = [f"{field} {low:g} → {high:g}" for field, (low, high) in moved(world.calm, world.hard).items()]
        size = f"{world.width} x {world.height}, {world.rate_hz:g} Hz"
        rows.append([f"`{name}`", world.about, size, world.frames(0.5, world.rate_hz), ", ".join(scaled)])
    yield table(["world", "what", "pictures", "frames at 0.5", "severity 0 → 1 moves"], rows)


def metrics(evaluator: str, part: str = "") -> Callable[[], Iterator[str]]:
    """The metrics that an evaluator declares, or that a tuple of its module `metrics` lists.

    Metrics share a row if nothing but the ends of their labels and summaries differs, from the last comma on.
    """

    def content() -> Iterator[str]:
        declared = installed().load("evaluator", evaluator).metrics
        if part:
            declared = getattr(import_module(f"codecbench.plugins.evaluators.{evaluator}.metrics"), part)
        rows: dict[tuple[str, ...], list[Metric]] = defaultdict(list)
        for metric in declared:
            stems = (text.rpartition(", ")[0] or text for text in (metric.label, metric.summary))
            rows[(*stems, metric.unit, metric.better, metric.role)].append(metric)
        lines = []
        for (label, summary, *shared), alike in rows.items():
            first, *others = alike
            heads = [metric.name for metric in alike if metric.headline]
            only = f" (`{'`, `'.join(heads)}`)" if len(heads) < len(alike) else ""
            cells = [
                ", ".join(f"`{metric.name}`" for metric in alike),
                "; ".join([first.label, *(metric.label.removeprefix(f"{label}, ") for metric in others)]),
                *shared,
                first.summary if len({metric.summary for metric in alike}) == 1 else summary,
            ]
            cells[4] += f", headline{only}" if heads else ""
            lines.append(f"| {' | '.join(cells)} |")
        yield "| metric | label | unit | better | role | definition |\n|---|---|---|---|---|---|"
        yield from lines

    return content
