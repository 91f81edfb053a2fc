"""What the pages' numbers come from, and the blocks that show them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Collection, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

import blocks
import tables
from blocks import Stamp

from codecbench.core.analysis.collect import open_run

ROOT: Final = Path(__file__).parents[2]
DATA: Final = os.environ.get("CODECBENCH_DATA", "")
OFFICE: Final = f"{DATA}/fr3_office_715"
CODECS: Final = tuple(
    ("codec", name)
    for name in ("raw", "png", "jpeg", "jpeg_qf", "jpeg2000", "multilevel", "jpegxl", "jpegls", "htj2k", "webp", "avif",
                 "zstd", "lz4", "rvl", "lerc", "zfp")
)  # fmt: skip
SLAM: Final = (("slam_backend", "orb"),)
FIRST: Final = (*((k, n) for k, n in CODECS if n in ("raw", "jpeg", "jpeg_qf", "jpeg2000", "multilevel")),
                *(("evaluator", name) for name in ("quality", "features", "operations", "timing")))  # fmt: skip
TRIED: Final = (*SLAM, ("codec", "h264"), ("codec", "jpeg"), ("evaluator", "localization"), ("evaluator", "trajectory"))

MATRICES: Final = ("first", "reference", "effort", "joining", "context", "tasks", "link", "link_room", "worlds",
                   "depth", "paper", "paper_loops", "slam_anchor")  # fmt: skip
"""Of examples/."""


@dataclass(frozen=True)
class Script:
    """What a Python program prints, or writes to OUT. plugins: whose results it shows, kind and name."""

    words: tuple[str, ...]
    plugins: tuple[tuple[str, str], ...] = ()


SCRIPTS: Final = {
    "sheet": Script(("docs/refresh/sheet.py",), (("dataset", "synthetic"),)),
    "processes": Script(("tests/benchmarks/processes.py",), (*FIRST, *SLAM)),
    "frames": Script(
        ("tests/benchmarks/slam_frames.py", "--frames", "300", f"office={OFFICE}", f"street={DATA}/kitti00_half@2"),
        SLAM,
    ),
    "faults": Script(("tests/benchmarks/slam_faults.py", OFFICE), (*SLAM, ("dataset", "synthetic"))),
    "drift": Script(
        ("tests/benchmarks/slam_runs.py", "--drift", "--starts", "2", "--calibration-errors", "0", "0.01",
         "--sequences", "street", "straight_road", "field", "room", "kitti00_half"),
        (*SLAM, ("dataset", "synthetic"), ("codec", "jpeg")),
    ),
    "benchmarks": Script(
        ("-m", "pytest", "tests/benchmarks/test_codecs.py", "tests/benchmarks/test_evaluators.py",
         "--benchmark-only", "--benchmark-json", "OUT"),
        (*CODECS, *(("evaluator", name) for name in ("quality", "features", "localization", "relative_pose"))),
    ),
    "largest": Script(
        ("-m", "pytest", "tests/fuzz", "--slow", "-n", "0", "-k", "largest", "-o", "log_cli=true", "-o",
         "log_cli_level=INFO"),
        tuple((k, n) for k, n in CODECS if n in ("png", "jpeg", "jpeg_qf", "jpeg2000", "multilevel")),
    ),
    "calibration": Script(("tests/support/simulated_tables.py",)),
    "newcomer": Script(("docs/newcomer.py", "--recording", OFFICE), tuple(dict.fromkeys((*FIRST, *TRIED)))),
}  # fmt: skip

NAMES: Final = (*MATRICES, *SCRIPTS)


@dataclass(frozen=True)
class Block:
    """A marked part of a page. jobs: what its content is made of; without any, of what the code declares. shows: the
    plugins of these jobs, kind and name, whose results it shows; all by default."""

    page: str
    jobs: tuple[str, ...]
    content: Callable[..., Iterator[str]]
    shows: tuple[tuple[str, str], ...] = ()

    def text(self, *results: Any) -> str:
        """What stands there, of what the jobs gave."""
        return "\n".join(self.content(*results)).rstrip("\n")


TIMES: Final = "docs/performance.md"
METRICS: Final = "docs/metrics.md"
QUESTIONS: Final = "docs/questions.md"
BLOCKS: Final = {
    "reference": Block("docs/reference-table.md", ("reference",), tables.reference),  # draws the figure of `answer`
    "answer": Block("README.md", ("reference",), tables.uses),
    "newcomer-run": Block(
        "README.md", ("newcomer",), tables.ended("examples/first.yaml", "(The pick of each codec.*)"), FIRST
    ),
    "newcomer-try": Block(
        "README.md", ("newcomer",), tables.ended("codecbench try", r"\n((?:Use|Nothing) [^\n]*)\n?$"), TRIED
    ),
    "first": Block("docs/first-run.md", ("first",), tables.settings(tables.CODING)),
    "on-wifi": Block(QUESTIONS, ("link",), tables.chosen_over_link("--link", "wifi_edge", "--error", "20cm")),
    "jpeg-quality": Block(QUESTIONS, ("reference",), tables.judged("jpeg")),
    "video-or-jpeg": Block(QUESTIONS, ("reference",), tables.picked("jpeg", "h264")),
    "intra": Block(QUESTIONS, ("reference",), tables.judged("h264 gop=1")),
    "crf": Block(QUESTIONS, ("reference",), tables.judged("h264")),
    "features": Block(QUESTIONS, ("reference",), tables.picked("h264", "hevc", "orb_features", "jpeg")),
    "effort": Block(QUESTIONS, ("effort",), tables.efforts),
    "paper-setting": Block(QUESTIONS, ("reference",), tables.picked("multilevel", "jpeg")),
    "features-order": Block(
        "docs/pictures-or-features.md", ("reference",),
        tables.order("jpeg", "h264", of=("jpeg", "h264", "orb_features")),
    ),
    "paper": Block("docs/reproduction.md", ("paper", "paper_loops"), tables.paper),
    "streams-joining": Block("docs/video.md", ("joining",), tables.settings(tables.JOINING)),
    "depth-lossless": Block("docs/depth.md", ("depth",), tables.depth_lossless),
    "depth-lossy": Block("docs/depth.md", ("depth",), tables.depth_lossy),
    "context-order": Block("docs/multilevel.md", ("context",), tables.order("jpeg")),
    "follow": Block("docs/task-metrics.md", ("tasks",), tables.followers),
    "link-room": Block(
        "docs/link.md", ("link_room",),
        tables.chosen_over_link("--link", "telemetry_900mhz", "--error", "35cm", "--all"),
    ),
    "conditions": Block("docs/worlds.md", (), tables.conditions),
    "sheet": Block("docs/worlds.md", ("sheet",), lambda text: iter([text.strip()])),
    "worlds": Block("docs/worlds.md", ("worlds",), tables.paths),
    "gaps": Block(
        "docs/slam.md", ("faults",),
        tables.printed("sequence", "black", "seen again", "maps, merged", "tracked %", "error, mm", "without the gap"),
    ),
    "faults": Block(
        "docs/slam.md", ("faults",), tables.printed("fault", "office", "room", "corridor_loop", "street", "field")
    ),
    "drift": Block(
        "docs/slam.md", ("drift",),
        tables.printed("sequence", "codec", "starts", "calibration error", "forward %", "reversed %", "symmetric %",
                       "by order %", "scatter", "median mm", "with a pose %"),
    ),
    "anchor": Block("docs/slam.md", ("slam_anchor",), tables.paths),
    "processes": Block(TIMES, ("processes",), tables.printed("what", "measured")),
    "codecs": Block(TIMES, ("benchmarks",), tables.coding_times),
    "evaluators": Block(TIMES, ("benchmarks",), tables.evaluator_times),
    "frame_times": Block(
        TIMES, ("frames",),
        tables.printed("frames of", "number", "mean", "median", "95 %", "99 %", "worst", "keyframes", "others"),
    ),
    "largest": Block(
        "docs/reliability.md", ("largest",), tables.printed("decoder", "image", "bytes", "time", "memory")
    ),
    **{
        f"metrics-{name}": Block(METRICS, (), tables.metrics(name))
        for name in ("quality", "depth", "features", "localization", "relative_pose", "place_recognition", "delivery",
                     "stream", "timing", "operations")
    },
    **{
        f"metrics-trajectory-{part}": Block(METRICS, (), tables.metrics("trajectory", part.upper()))
        for part in ("accuracy", "live", "behaviour", "compared")
    },
    "commands": Block("docs/commands.md", (), tables.commands),
    "calibration": Block(
        "docs/verdict.md", ("calibration",),
        tables.printed("noise of a codec's values", "frames", "ordered", "covers", "width", "ordered, alike",
                       "covers, alike", "width, alike"),
    ),
}  # fmt: skip


def run(name: str, work: Path) -> None:
    """Do a job, or what is left of it. Raises subprocess.CalledProcessError if it fails."""
    if name in MATRICES:
        words = ["-m", "codecbench", "run", f"examples/{name}.yaml", "--out", str(result_of(name, work))]
        subprocess.run([sys.executable, *words], cwd=ROOT, check=True)
        return
    script, file = SCRIPTS[name], result_of(name, work)
    stamp = Stamp.of_today(script.plugins)
    if file.exists() and made(name, work)[1].plugins == stamp.plugins:
        return
    part = file.with_suffix(".part")
    words = [str(part) if word == "OUT" else word for word in script.words]
    with (work / f"{name}.out" if "OUT" in script.words else part).open("w") as out:
        subprocess.run([sys.executable, *words], cwd=ROOT, check=True, stdout=out)
    part.write_text(json.dumps({"output": part.read_text(), **asdict(stamp)}, default=sorted))
    part.replace(file)


def writable(job: str, work: Path, todo: Collection[str]) -> list[str]:
    """The blocks that can be written now that a job is done, and those that need none."""
    there = {name for name in NAMES if result_of(name, work).exists()} - set(todo)
    return [name for name, block in BLOCKS.items() if not block.jobs or (job in block.jobs and there >= {*block.jobs})]


def result_of(job: str, work: Path) -> Path:
    """The folder of a run, or the file of what a script printed, with its stamp."""
    return work / job if job in MATRICES else work / f"{job}.json"


def made(name: str, work: Path) -> tuple[Any, Stamp]:
    """What a job gave, for the functions of tables, and its stamp."""
    place = result_of(name, work)
    if name in MATRICES:
        result = open_run(place)
        return result, Stamp.of_run(result)
    entry = json.loads(place.read_text())
    plugins = frozenset((kind, name, version) for kind, name, version in entry["plugins"])
    return entry["output"], Stamp(entry["day"], frozenset(entry["commits"]), frozenset(entry["processors"]), plugins)


def write(name: str, work: Path, root: Path = ROOT) -> bool:
    """Write a block from what its jobs gave; False if it was so before."""
    block = BLOCKS[name]
    given = [made(job, work) for job in block.jobs]
    stamp = Stamp.of_all(each for _, each in given) if given else None
    if stamp and block.shows:
        stamp = replace(stamp, plugins=frozenset(p for p in stamp.plugins if p[:2] in block.shows))
    return blocks.write(root / block.page, name, block.text(*(result for result, _ in given)), stamp)


def check(root: Path = ROOT) -> Iterator[str]:
    """Blocks that nothing makes, no run made, other plugins than today's made, or somebody edited, and missing ones."""
    known = {(block.page, name) for name, block in BLOCKS.items()}
    for page in (root / "README.md", *sorted(root.glob("docs/**/*.md"))):
        place = str(page.relative_to(root))
        for name, content in blocks.blocks_of(page).items():
            if (place, name) not in known:
                yield f"{place}: {name}: nothing makes it"
                continue
            known.remove((place, name))
            if jobs := BLOCKS[name].jobs:
                again = f"; make it again: python docs/refresh {' '.join(jobs)}"
                yield from (f"{place}: {name}: {fault}{again}" for fault in blocks.faults(page, content))
            elif content != BLOCKS[name].text():
                yield f"{place}: {name}: differs from what the code declares; write it again: python docs/refresh sheet"
    yield from (f"{place}: {name}: the page has no such block" for place, name in sorted(known))
