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
from itertools import chain, combinations
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import spearmanr

from codecbench.core.analysis.ranking import Ranked, Ranking, rankings
from codecbench.core.analysis.run_result import RunResult
from codecbench.core.contracts.codec import Codec
from codecbench.core.contracts.metric import Metric
from codecbench.core.engine.plugins.registry import installed
from codecbench.core.report.answers import Answer, Answers, answers
from codecbench.core.report.costs import coding_ms, rate_cell
from codecbench.core.report.formatting import signed_percent
from codecbench.core.report.picks import measured_values
from codecbench.core.report.tables import cell, table
from codecbench.paper.measured import Measured
from codecbench.paper.page import contradiction_list, deviations, tracking_limits
from codecbench.plugins.datasets.synthetic.worlds.conditions import changing_conditions
from codecbench.plugins.datasets.synthetic.worlds.presets import WORLDS

IMAGES: Final = Path(__file__).parents[1] / "images"
CSVS: Final = Path(__file__).parents[1] / "tables"
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
    "keypoint repeatability": Column("features.keypoint_repeatability.mean"),
    "search ms": Column("timing.prepare_cpu_ms.median"),
    "encode ms": Column("timing.encode_cpu_ms.median"),
    "decode ms": Column("timing.decode_cpu_ms.median"),
    "counted Mops": Column("operations.source_total.encode.mean", 1e-6),
    "paper's model Mops": Column("operations.model_total.encode.mean", 1e-6),
}
TASKS: Final = RATE | {
    "localization AUC": Column("localization.located_auc.mean"),
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
TIMES: Final = {
    "encode ms": Column("timing.encode_wall_ms.median"),
    "decode ms": Column("timing.decode_wall_ms.median"),
}
DEPTH: Final = {
    "error / noise": Column("depth.noise_ratio.mean"),
    "mean mm": Column("depth.mean_error_mm.mean"),
    "99 % mm": Column("depth.p99_error_mm.mean"),
    "at edges mm": Column("depth.edge_error_mm.mean"),
    "gained %": Column("depth.invented_percent.mean"),
    "flying %": Column("depth.flying_percent.mean"),
    "normals deg": Column("depth.normal_error_deg.mean"),
}
PATHS: Final = {
    "tracked": Column("trajectory.tracked_fraction.median"),
    "ATE mm": Column("trajectory.ate_rmse_m.median", 1e3),
    "95 % from": Column("trajectory.ate_rmse_m.ci95_low", 1e3),
    "to": Column("trajectory.ate_rmse_m.ci95_high", 1e3),
    "runs that succeed": Column("trajectory.success.mean"),
}


def settings(columns: dict[str, Column]) -> RunTable:
    """One row for each setting on a run's only sequence."""

    def content(run: RunResult) -> Iterator[str]:
        (entry,) = run.plan.sequences
        rows = [{str(k): v for k, v in row.items()} for row in run.wide.to_dict("records")]
        cells = [[row["codec"], row["setting"], *(column.shown(row) for column in columns.values())] for row in rows]
        yield f"{entry.frames} frames of {entry.name}:\n"
        yield table(["codec", "setting", *columns], cells)

    return content


def depth_lossless(run: RunResult) -> Iterator[str]:
    """The settings without any error by size, with their size on each sequence and their times on the first."""
    first, *others = run.plan.sequences
    rows = [row for row in _rows(run, first.name) if row["depth.worst_error_mm.max"] == 0]
    rates = [{(row["codec"], row["setting"]): row for row in _rows(run, entry.name)} for entry in (first, *others)]
    rate = RATE["bit/px"]
    cells = [
        [*key, *(rate.shown(of[key]) for of in rates), *(column.shown(rates[0][key]) for column in TIMES.values())]
        for key in sorted(((row["codec"], row["setting"]) for row in rows), key=lambda key: rates[0][key][rate.name])
    ]
    yield f"{' and '.join(f'{entry.frames} frames of {entry.name}' for entry in run.plan.sequences)}:\n"
    yield table(["codec", "setting", *(f"bit/px, {entry.name}" for entry in run.plan.sequences), *TIMES], cells)


def depth_lossy(run: RunResult) -> Iterator[str]:
    """The settings with errors on the first sequence."""
    entry = run.plan.sequences[0]
    rows = [row for row in _rows(run, entry.name) if row["depth.worst_error_mm.max"] > 0]
    columns = (*RATE.values(), *DEPTH.values())
    cells = [[row["codec"], row["setting"], *(column.shown(row) for column in columns)] for row in rows]
    yield f"{entry.frames} frames of {entry.name}:\n"
    yield table(["codec", "setting", *RATE, *DEPTH], cells)


def _rows(run: RunResult, sequence: str) -> list[Row]:
    rows = [{str(k): v for k, v in row.items()} for row in run.wide.to_dict("records")]
    return [row for row in rows if row["sequence"] == sequence]


def paths(run: RunResult) -> Iterator[str]:
    """One row for each sequence, setting and backend of `trajectory`, without columns that have nothing."""
    titles = {name.partition(".")[0] for name in run.wide if re.match(r"trajectory\b.*\.success\.mean$", name)}
    rows = []
    for row in run.wide.to_dict("records"):
        for title in sorted(titles):
            values = {str(name).replace(f"{title}.", "trajectory."): value for name, value in row.items()}
            keys = {head: row[head] for head in ("sequence", "codec", "setting")}
            backend = title.partition("=")[2].strip("()") or "–"
            rows.append(keys | {"backend": backend} | {head: column.shown(values) for head, column in PATHS.items()})
    shown = pd.DataFrame(rows)
    shown = shown.loc[:, (shown != "–").any()]
    yield table(list(shown), shown.to_numpy().tolist())


def order(*anchors: str, of: tuple[str, ...] = ()) -> RunTable:
    """Codecs, by default all, in order of each task over all sequences, with their rates vs. anchors."""

    def content(run: RunResult) -> Iterator[str]:
        rows = []
        for ranking in rankings(run, brief=True):
            for ranked in (each for each in ranking.ranked if _named(each.curve, of)):
                beside = [ranking.evidence(ranked.curve, anchor) for anchor in anchors]
                saved = ["–" if evidence is None else signed_percent(evidence) for evidence in beside]
                rows.append([ranking.column.label, ranked.curve, *saved, ", ".join(ranked.ahead_of) or "–"])
        yield table(["task", "codec", *(f"rate vs. {anchor}" for anchor in anchors), "better than"], rows)

    return content


def picked(*prefixes: str) -> RunTable:
    """The pick of each codec, by default of all, over all sequences, with its times and its rate vs. JPEG for equal
    localization."""

    def content(run: RunResult) -> Iterator[str]:
        found, ranking = answers(run), located(run)
        chosen = [each for each in found.answers if _named(each.curve, prefixes)]
        rows = [_pick(run, found, ranking, each) for each in chosen]
        yield table(list(rows[0]), [list(row.values()) for row in rows])

    return content


def _pick(run: RunResult, found: Answers, ranking: Ranking, each: Answer) -> dict[str, str]:
    """A row of `picked`; without a pick, of the codec's rate vs. JPEG alone."""
    evidence, pick = ranking.evidence(each.curve, "jpeg"), each.limit.lowest
    row = dict.fromkeys(("codec", "setting", "Mbit/s", "localization AUC", "tracked", "encode ms", "decode ms"), "–")
    row |= {"codec": f"`{each.curve}`", "rate vs. JPEG": "–" if evidence is None else signed_percent(evidence)}
    if pick is None:
        return row | {"setting": "none passes" if each.passes is False else "none is known to pass"}
    seen = measured_values(pick)
    encode_ms, decode_ms = (cell(float(f"{ms:.2g}")) for ms in coding_ms(run, found.on, each.curve, pick))
    return row | {
        "setting": f"`{pick.point}`" if pick.point else "–", "Mbit/s": rate_cell(run, found.on, each.curve, pick)[1],
        "localization AUC": seen["located"], "tracked": seen["runs"], "encode ms": encode_ms, "decode ms": decode_ms,
    }  # fmt: skip


def judged(curve: str) -> RunTable:
    """Every setting of a codec, means over all sequences, from the most rate to the least, and whether it passes."""

    def content(run: RunResult) -> Iterator[str]:
        found = answers(run)
        (limit,) = [each.limit for each in found.answers if each.curve == curve]
        rows = []
        for test in limit.settings:
            auc, success = (
                _of(run, f"{curve} {test.point}", name) for name in ("localization.located_auc", "trajectory.success")
            )
            tracked = f"{100 * success.mean():.0f} %"
            rate = rate_cell(run, found.on, curve, test)[1]
            rows.append([f"`{test.point}`", rate, f"{auc.mean():.3f}", f"{auc.min():.3f}", tracked, test.verdict])
        yield table(["setting", "Mbit/s", "localization AUC", "of the worst scene", "tracked", "verdict"], rows)

    return content


def _named(curve: str, prefixes: tuple[str, ...]) -> bool:
    """Whether a curve is of one of these codecs, or of all if there are none."""
    return not prefixes or any(f"{curve} ".startswith(f"{prefix} ") for prefix in prefixes)


def _of(run: RunResult, words: str, metric: str) -> NDArray[np.float64]:
    """The first statistic of a metric on all sequences, for a codec with exactly these parameters."""
    codec, *parameters = words.split()
    rows = [
        one == codec and {*parameters} == {*setting.split()}
        for one, setting in zip(run.wide["codec"], run.wide["setting"], strict=True)
    ]
    (name, *_) = (str(name) for name in run.wide if str(name).startswith(f"{metric}."))
    return run.wide[rows][name].to_numpy(float)


def located(run: RunResult) -> Ranking:
    """Codecs by localization over all sequences."""
    return next(each for each in rankings(run, brief=True) if each.column.name == "localization.located_auc.mean")


def reference(run: RunResult) -> Iterator[str]:
    """The figure of localization in the office, and the picks."""
    yield _figure(run, "office-rate-located_auc", "localization", "Localization over the rate, one line a codec")
    yield from picked()(run)
    yield _everything("reference", run)


def paper(run: RunResult, loops: RunResult) -> Iterator[str]:
    """The paper's contradictions, down to which setting tracking works, and what differs from the paper."""
    both = [Measured(run), Measured(loops)]
    yield from chain(contradiction_list(both), tracking_limits(both))
    yield _figure(loops, "kitti00_half-rate-ate_rmse_m", "paper", "Error of the road's trajectory over the rate")
    yield _everything("paper", run, loops) + "\n"
    yield from deviations()


def _figure(run: RunResult, name: str, image: str, title: str) -> str:
    """A figure of `codecbench plot`, kept as an image of the docs."""
    with tempfile.TemporaryDirectory() as folder:
        command("plot", str(run.folder), "--out", folder)
        shutil.copy(Path(folder) / f"{name}.svg", IMAGES / f"{image}.svg")
    return f"![{title}](images/{image}.svg)\n"


def _everything(name: str, *runs: RunResult) -> str:
    """A CSV file of all settings on all sequences of runs, and what links it."""
    keys = ["sequence", "codec", "setting"]
    rows = pd.concat([run.wide for run in runs])
    wanted = dict.fromkeys(column.name for column in (CODING | TASKS | PATHS).values())
    columns = [name for one in wanted for name in rows if re.sub(r"\(.*?\)", "", str(name)) == one]
    rows[[*keys, *columns]].to_csv(CSVS / f"{name}.csv", index=False, float_format="%.5g")
    return f"All settings on all sequences: [{name}.csv](tables/{name}.csv), {len(rows)} rows."


def uses(run: RunResult) -> Iterator[str]:
    """Of the picks the one of least rate, of least rate whose frames stand alone, of least time, and of features."""
    found, ranking = answers(run), located(run)
    rows = {each.curve: _pick(run, found, ranking, each) for each in found.answers if each.limit.lowest}
    chosen = {
        "Least rate": next(iter(rows)),
        "Each frame stands alone": next(
            curve for curve in rows if issubclass(installed().load("codec", curve.split()[0]), Codec)
        ),
        "Least encoding time": min(rows, key=lambda curve: float(rows[curve]["encode ms"])),
        "Features, no picture": next(curve for curve in rows if curve.startswith("orb_features")),
    }
    shown = ("use", "codec", "setting", "Mbit/s", "localization AUC", "encode ms")
    yield "![Localization over the rate, one line a codec](docs/images/localization.svg)\n"
    yield table(shown, [[use, *(rows[curve][head] for head in shown[1:])] for use, curve in chosen.items()])


def efforts(run: RunResult) -> Iterator[str]:
    """Of codecs with two curves what the slower saves for equal keypoint repeatability, and both encoding times."""
    (ranking,) = [each for each in rankings(run, brief=True) if len(each.sequences) > 1]
    ms = {ranked.curve: _encode_ms(run, ranked) for ranked in ranking.ranked}
    rows = []
    for fast, slow in combinations(sorted(ms, key=ms.__getitem__), 2):
        (codec, *of_fast), (other, *of_slow) = fast.split(), slow.split()
        if codec == other and (evidence := ranking.evidence(slow, fast)):
            better = (
                "yes" if any(fast in each.ahead_of for each in ranking.ranked if each.curve == slow) else "not shown"
            )
            efforts = [
                f"`{' '.join(words)}`, {float(f'{ms[name]:.2g}'):g} ms"
                for words, name in ((of_fast, fast), (of_slow, slow))
            ]
            rows.append([f"`{codec}`", *efforts, signed_percent(evidence), better])
    yield table(["codec", "fast", "slow", "rate of slow vs. fast", "significantly better"], sorted(rows))


def _encode_ms(run: RunResult, ranked: Ranked) -> float:
    """The mean over sequences and settings of a curve."""
    points = {point for names in ranked.settings.values() for point in names}
    return float(np.mean([_of(run, f"{ranked.curve} {point}", "timing.encode_cpu_ms").mean() for point in points]))


def followers(run: RunResult) -> Iterator[str]:
    """Spearman correlation of the means of cheaper metrics with those of tasks, over lossy settings."""
    tasks = {
        "localization AUC": "localization.located_auc", "map points found": "localization.tracked_inliers",
        "relative pose AUC": "relative_pose.pose_auc_10deg", "correct matches": "relative_pose.correct_matches",
    }  # fmt: skip
    cheaper = {
        "PSNR": "quality.psnr_gray_db", "SSIM": "quality.ssim_matlab",
        "keypoint repeatability, the SLAM's ORB": "features.keypoint_repeatability",
        "matches kept, the SLAM's ORB": "features.matches_kept",
        "keypoint repeatability, OpenCV's ORB": "features.opencv_keypoint_repeatability",
        "matches kept, OpenCV's ORB": "features.opencv_matches_kept",
    }  # fmt: skip
    lossy = run.wide[np.isfinite(run.wide["quality.psnr_gray_db.mean"])]
    rows = []
    for label, metric in cheaper.items():
        pairs = [(lossy[f"{metric}.mean"], lossy[f"{task}.mean"]) for task in tasks.values()]
        rows.append([label, *(f"{float(spearmanr(a, b, nan_policy='omit').statistic):.3f}" for a, b in pairs)])
    yield table(["metric", *tasks], rows)
    yield f"{len(lossy)} lossy settings of {lossy['codec'].nunique()} codecs on {run.plan.sequences[0].frames} frames."


def chosen_over_link(*words: str) -> RunTable:
    """What `codecbench choose` says with these options, without its headings."""

    def content(run: RunResult) -> Iterator[str]:
        printed = command("choose", str(run.folder), *words, "--format", "markdown")
        yield re.sub(r"^### .*\n\n", "", printed, flags=re.MULTILINE).strip()

    return content


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
    heads = [f"{picture} {way}" for picture in ("gray", "rgb", "depth") for way in ("encode", "decode")]
    rows = [
        [titles.get(codec, f"`{codec}`"), *(round(each[h], 2) if h in each else None for h in heads)]
        for codec, each in ms.items()
    ]
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
        scaled = [
            f"{field} {low:g} → {high:g}" for field, (low, high) in changing_conditions(world.calm, world.hard).items()
        ]
        size = f"{world.width} x {world.height}, {world.rate_hz:g} Hz"
        rows.append([f"`{name}`", world.about, size, world.frames(0.5, world.rate_hz), ", ".join(scaled)])
    yield table(["world", "what", "pictures", "frames at 0.5", "severity 0 → 1 moves"], rows)


def commands() -> Iterator[str]:
    """The help of every command, from a process of its own: click remembers how help was first asked for."""
    script = Path(__file__).with_name("command_help.py")
    yield subprocess.run([sys.executable, str(script)], stdout=subprocess.PIPE, text=True, check=True).stdout


_ARROWS: Final = {"higher": "↑", "lower": "↓", "neither": ""}


def metrics(evaluator: str, part: str = "") -> Callable[[], Iterator[str]]:
    """The metrics that an evaluator declares, or that a tuple of its module `metrics` lists.

    Metrics share a row if nothing but the ends of their labels and summaries differs, from the last comma on, or if
    they have one summary, and labels without a comma. Headlines are bold. No unit is a pure number; a role of all
    stands in the head.
    """

    def content() -> Iterator[str]:
        declared = installed().load("evaluator", evaluator).metrics
        if part:
            declared = getattr(import_module(f"codecbench.plugins.evaluators.{evaluator}.metrics"), part)
        rows: dict[tuple[str, ...], list[Metric]] = defaultdict(list)
        for metric in declared:
            label, comma, _ = metric.label.rpartition(", ")
            summary = metric.summary.rpartition(", ")[0] if comma else ""
            rows[label, summary or metric.summary, metric.unit, metric.better, metric.role].append(metric)
        common = {metric.role for metric in declared}
        if len(common) > 1:
            yield "| metric | label | unit | role | definition |\n|---|---|---|---|---|"
        else:
            yield f"| metric | label | unit | definition (role `{', '.join(common)}`) |\n|---|---|---|---|"
        for (label, summary, unit, better, role), alike in rows.items():
            ends = [metric.label.removeprefix(f"{label}, ") for metric in alike[1:]]
            cells = [
                ", ".join(f"**`{metric.name}`**" if metric.headline else f"`{metric.name}`" for metric in alike),
                "; ".join([alike[0].label, *ends]),
                f"{unit.removeprefix('1')} {_ARROWS[better]}".strip(),
                *([role] if len(common) > 1 else []),
                alike[0].summary if len({metric.summary for metric in alike}) == 1 else summary,
            ]
            yield f"| {' | '.join(cells)} |"

    return content
