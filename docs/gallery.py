"""docs/gallery.md and docs/gallery/, made from bundles: `python docs/gallery.py runs/first.bundle.zip ...` writes them.

With --check nothing is written; the exit status is 1 if the page is not what these bundles make.
"""

from __future__ import annotations

import argparse
import hashlib
import re
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import codecbench
from codecbench.core.analysis.run_result import RunResult
from codecbench.core.report.formatting import verdicts
from codecbench.core.report.tables import escaped, foreign_table

ROOT = Path(__file__).parents[1]
PAGE = Path(__file__).parent / "gallery.md"
REPORTS = Path(__file__).parent / "gallery"
HEAD = """# Gallery

Runs that were bundled: what was run, on what, what came out, and the report, without pictures, which no bundle holds.
`python docs/gallery.py BUNDLE ...` makes this page from the bundles alone. A bundle's SHA-256 says which numbers are
meant; a run on another machine has other times in it, so its bundle has another one, and `codecbench verify-run` says
which cells agree. [Citing a run](citing.md) explains both.
"""
MOST_SENTENCES = 3
"""Of each verdict."""


def page(paths: list[Path], reports: Path | None = None) -> str:
    """The page as Markdown. reports: a folder to write the reports into."""
    parts = [HEAD]
    for path in paths:
        with tempfile.TemporaryDirectory() as folder:
            run = codecbench.open_bundle(path, Path(folder) / "run")
            parts.append("\n".join(section(run, path)))
            if reports is not None:
                made = run.report(Path(folder) / "report.html").read_text(encoding="utf-8")
                reports.mkdir(exist_ok=True)
                (reports / f"{name(path)}.html").write_text(without_folders(made), encoding="utf-8")
    return "\n".join(parts) + "\n"


def name(path: Path) -> str:
    """What a bundle is called without its ending."""
    return path.name.removesuffix(".bundle.zip")


def without_folders(text: str) -> str:
    """Tracebacks without the folders of the machine that the package lay in."""
    return re.sub(r"(?:/[\w.+-]+)+/(?=codecbench/)", "", text)


def section(run: RunResult, path: Path) -> Iterator[str]:
    """The lines about a bundle."""
    content = path.read_bytes()
    results = [result for result in run.results if result.status == "ok"]
    settings = {(result.cell.codec.name, result.cell.codec.label) for result in results}
    codecs = sorted({codec for codec, _ in settings})
    frames = ", ".join(f"{escaped(entry.name)} ({entry.frames} frames)" for entry in run.plan.sequences)
    judges = ", ".join(escaped(title) for title in dict.fromkeys(result.cell.evaluator.title for result in results))
    yield f"## {escaped(run.plan.name)}\n"
    yield "| | |\n|---|---|"
    yield f"| what was run | {len(settings)} settings of {len(codecs)} codecs: {escaped(', '.join(codecs))} |"
    yield f"| on what | {frames} |"
    yield f"| judged by | {judges} |"
    yield f"| cells with a result | {len(results)} of {len(run.plan.cells)} |"
    yield f"| machine | {machines(run)} |"
    yield f"| report | [{escaped(name(path))}.html](gallery/{name(path)}.html) |"
    yield f"| bundle | {escaped(path.name)}, {len(content):,} bytes |"
    yield f"| SHA-256 | `{hashlib.sha256(content).hexdigest()}` |\n"
    for verdict in verdicts(run, brief=True):
        yield f"**{escaped(verdict.title)}**\n"
        if verdict.rows:
            yield foreign_table(verdict.heads, verdict.rows)
        yield " ".join(map(escaped, verdict.sentences[:MOST_SENTENCES])) + "\n"
    yield "Made, and its report opened, by\n"
    yield "```bash"
    yield from made_by(run, path)
    yield f"codecbench open {path.name}\n```\n"


def made_by(run: RunResult, path: Path) -> Iterator[str]:
    """The commands: of the example of that matrix where there is one, else of the matrix in the bundle."""
    same = [file for file in sorted((ROOT / "examples").glob("*.yaml")) if file.read_text() == run.plan.matrix_text]
    matrix = same[0].relative_to(ROOT) if same else "matrix.yaml"
    yield f"codecbench run {matrix} --out {name(path)}"
    yield f"codecbench bundle {name(path)}"


def machines(run: RunResult) -> str:
    """The processors that computed it."""
    names = {str(environment.get("machine", {}).get("cpu")) for environment in run.environments.values()}
    return escaped(", ".join(sorted(names)) or "not known")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bundles", nargs="+", type=Path)
    parser.add_argument("--check", action="store_true")
    arguments = parser.parse_args()
    made = page(arguments.bundles, None if arguments.check else REPORTS)
    if arguments.check:
        sys.exit(int(PAGE.read_text() != made))
    PAGE.write_text(made)


if __name__ == "__main__":
    main()
