"""The tables of README.md and docs/, made from run folders, pictures, benchmarks, and rows that a command printed.

python docs/tables.py --run real=runs/real --benchmarks benchmarks.json --printed processes=processes.txt

rewrites every block that these can make, between `<!-- NAME: begin -->` and `<!-- NAME: end -->`. With --check nothing
is written: the blocks that differ are named, and the exit status is 1 if there are any.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import benchmark_tables
import feature_tables
import multilevel_table
import newcomer
import run_tables
import slam_faults
import stream_tables
import task_tables

import codecbench

ROOT = Path(__file__).parents[1]
Kind = Literal["run", "pictures", "benchmarks", "printed"]


@dataclass(frozen=True)
class Block:
    """A marked part of a page. columns: heads of its tables. content: its Markdown, from the source that it needs."""

    page: str
    kind: Kind
    source: str
    columns: tuple[str, ...]
    content: Callable[[Any, tuple[str, ...]], Iterator[str]]


CODING = (*run_tables.SETTING, *run_tables.CODING)
BESIDE = (
    *(head for head in CODING if head not in ("CR vs PNG %", "paper's model Mops")),
    "Kodak: bit/px",
    "Kodak: features kept",
)
TIMES = "docs/performance.md"
BLOCKS = {
    "features-by-task": Block(
        "docs/pictures-or-features.md", "run", "features", ("codec", "setting", *feature_tables.TASKS),
        feature_tables.every_setting,
    ),
    "features-order": Block(
        "docs/pictures-or-features.md", "run", "features",
        ("task", "codec", "rate vs. jpeg", "rate vs. h264", "better than"), stream_tables.order,
    ),
    "streams-joining": Block(
        "docs/video.md", "run", "joining", ("codec", "setting", *stream_tables.JOINING), stream_tables.joining
    ),
    "real": Block("docs/real.md", "run", "real", BESIDE, run_tables.beside_photographs),
    "sequences": Block("docs/real.md", "run", "real", CODING, run_tables.every_sequence),
    "rates-beside-jpeg": Block(
        "docs/multilevel.md", "run", "context", ("sequence", "codec", "PSNR", "SSIM", "features kept"),
        run_tables.rates_beside_anchor,
    ),
    "answer": Block(
        "README.md", "run", "features", ("codec", "rate vs. JPEG", "significantly better"),
        feature_tables.answer,
    ),
    "newcomer-run": Block(
        "README.md", "printed", "newcomer", (), newcomer.ended("examples/first.yaml", "(The pick of each codec.*)")
    ),
    "newcomer-tests": Block("README.md", "printed", "newcomer", (), newcomer.ended("bin/pytest", r"(\d+ passed.*)")),
    "newcomer-try": Block(
        "README.md", "printed", "newcomer", (), newcomer.ended("codecbench try", r"\n((?:Use|Nothing) [^\n]*)\n?$")
    ),
    "first": Block("docs/first-run.md", "run", "first", CODING, run_tables.first_sequence),
    "known": Block(
        "docs/task-metrics.md", "run", "tasks",
        ("metric", "quality 30", "quality 25", "difference [95 %]", "p", "smallest shown", "frames",
         "degrees of freedom"),
        task_tables.known_order,
    ),
    "follow": Block(
        "docs/task-metrics.md", "run", "tasks",
        ("metric", "localisation AUC", "map points found", "relative pose AUC", "correct matches"),
        task_tables.followers,
    ),
    "gaps": Block("docs/slam.md", "printed", "faults", slam_faults.GAPS, benchmark_tables.printed),
    "faults": Block("docs/slam.md", "printed", "faults", slam_faults.FAULTS, benchmark_tables.printed),
    "link-room": Block(
        "docs/link.md", "printed", "link_room",
        ("setting", r"rate \[kbit/s\]", r"error \[m\]", "fresh pose", "runs", "verdict", "because"),
        benchmark_tables.without_headings,
    ),
    "conditions": Block(
        "docs/worlds.md", "printed", "conditions",
        ("world", "what", "pictures", "frames at 0.5", "severity 0 → 1 moves"), benchmark_tables.printed,
    ),
    "features-by-rate": Block(
        "docs/pictures-or-features.md", "printed", "features",
        ("sent", "bytes a frame", "bit/pixel", "bytes a feature", "tracked", "ATE mm", "as raw"),
        benchmark_tables.printed,
    ),
    "sizes": Block(
        "docs/multilevel.md", "pictures", "",
        ("QF", "KiB", "of which tables", "the paper, KiB", "two levels", "two levels, by frequency", "without header"),
        multilevel_table.sizes,
    ),
    "codecs": Block(TIMES, "benchmarks", "", ("codec", "gray", "RGB"), benchmark_tables.codecs),
    "multilevel": Block(
        TIMES, "benchmarks", "", ("`multilevel`", "qf 5", "qf 20", "qf 100"), benchmark_tables.multilevel
    ),
    "kernels": Block(
        TIMES, "benchmarks", "", ("codec", "compiled", "counting", "ratio"), benchmark_tables.kernel_builds
    ),
    "contract": Block(
        TIMES, "benchmarks", "", ("a JPEG frame", "bare calls", "through the engine", "added"),
        benchmark_tables.contract,
    ),
    "evaluators": Block(
        TIMES, "benchmarks", "", ("evaluators", "median"), benchmark_tables.medians("test_evaluators")
    ),
    "solvers": Block(TIMES, "benchmarks", "", ("solvers", "median"), benchmark_tables.medians("test_slam_solvers")),
    "processes": Block(TIMES, "printed", "processes", ("what", "measured"), benchmark_tables.printed),
    "frame_steps": Block(TIMES, "printed", "frames", ("step", "office", "street"), benchmark_tables.printed),
    "frame_times": Block(
        TIMES, "printed", "frames",
        ("frames of", "number", "mean", "median", "95 %", "99 %", "worst", "keyframes", "others"),
        benchmark_tables.printed,
    ),
    "frame_memory": Block(
        TIMES, "printed", "memory",
        ("sequence", "frames", "keyframes made", "left", "points made", "arrays", "a frame"), benchmark_tables.printed,
    ),
    "calibration": Block(
        "docs/verdict.md", "printed", "calibration",
        ("noise of a codec's values", "frames", "ordered", "covers", "width", "ordered, alike", "covers, alike",
         "width, alike"), benchmark_tables.printed,
    ),
    "largest": Block(
        "docs/reliability.md", "printed", "largest", ("decoder", "image", "bytes", "time", "memory"),
        benchmark_tables.printed,
    ),
}  # fmt: skip
"""Every marked block of the documentation, by the name in its markers."""


def marked(name: str) -> re.Pattern[str]:
    return re.compile(rf"(<!-- {name}: begin -->\n)(.*?)(\n<!-- {name}: end -->)", re.DOTALL)


def replaced(page: str, name: str, content: str) -> str:
    """A page with the content of a block replaced. Raises SystemExit where the page has no such block."""
    after, count = marked(name).subn(lambda found: found[1] + content.rstrip("\n") + found[3], page)
    if count != 1:
        raise SystemExit(f"{BLOCKS[name].page}: {count} blocks are marked `{name}`; there must be one")
    return after


def sources(chosen: argparse.Namespace) -> dict[tuple[Kind, str], Any]:
    """What was given to make blocks from, by kind and name."""
    given: dict[tuple[Kind, str], Any] = {}
    for name, folder in map(named, chosen.run):
        given["run", name] = codecbench.open_run(folder)
    for name, file in map(named, chosen.printed):
        given["printed", name] = Path(file).read_text()
    if chosen.pictures:
        given["pictures", ""] = chosen.pictures
    if chosen.benchmarks:
        given["benchmarks", ""] = json.loads(chosen.benchmarks.read_text())["benchmarks"]
    known = {(block.kind, block.source) for block in BLOCKS.values()}
    if unknown := [f"{kind} {name}" for kind, name in given if (kind, name) not in known]:
        raise SystemExit(f"no block is made from {', '.join(unknown)}; known: {sorted(known)}")
    return given


def named(text: str) -> tuple[str, str]:
    name, _, path = text.partition("=")
    if not path:
        raise SystemExit(f"{text!r} is not NAME=PATH")
    return name, path


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", action="append", default=[], metavar="NAME=FOLDER")
    parser.add_argument("--pictures", type=Path, metavar="FOLDER", help="PNG files for the sizes of `multilevel`")
    parser.add_argument("--benchmarks", type=Path, metavar="FILE", help="what `pytest --benchmark-json FILE` wrote")
    parser.add_argument("--printed", action="append", default=[], metavar="NAME=FILE")
    parser.add_argument("--root", type=Path, default=ROOT, help="the folder of README.md and docs/")
    parser.add_argument("--check", action="store_true", help="write nothing; exit status 1 if a block differs")
    parser.add_argument("--list", action="store_true", help="print what blocks there are, as JSON")
    chosen = parser.parse_args()
    if chosen.list:
        print(json.dumps({name: {"page": block.page, "columns": block.columns} for name, block in BLOCKS.items()}))
        return
    given = sources(chosen)
    if not given:
        parser.error("name at least one --run, --pictures, --benchmarks or --printed")
    differing = 0
    for name, block in BLOCKS.items():
        if (block.kind, block.source) in given:
            path = chosen.root / block.page
            before = path.read_text()
            after = replaced(before, name, "\n".join(block.content(given[block.kind, block.source], block.columns)))
            differing += before != after
            print(f"{block.page}: {name}: {'same' if before == after else 'differs' if chosen.check else 'written'}")
            if not chosen.check and before != after:
                path.write_text(after)
    sys.exit(1 if chosen.check and differing else 0)


if __name__ == "__main__":
    main()
