"""docs/verdict.md shows what `codecbench rank` prints of the run that it shows."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path

import pytest
from installed_command import COMMAND
from project import DOCS

from codecbench.core.analysis.limits import Standing

PAGE = (DOCS / "verdict.md").read_text()


def call(folder: Path, *words: str) -> str:
    done = subprocess.run([str(COMMAND), *words], cwd=folder, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def rows(text: str) -> list[list[str]]:
    """Cells of the lines that begin with a place."""
    lines = (line.strip() for line in text.splitlines())
    return [re.split(r"  +", line) for line in lines if re.match(r"\d", line)]


@pytest.mark.thorough
def test_the_example_is_what_is_printed(tmp_path: Path) -> None:
    """Places, codecs, groups and claims; the rates to ten per cent, for they depend on the codecs' libraries."""
    (matrix,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    (shown,) = re.findall(r"```\n\$ codecbench rank runs/small\n(.*?)```", PAGE, re.DOTALL)
    (tmp_path / "small.yaml").write_text(matrix)
    ran = call(tmp_path, "run", "small.yaml")
    printed = call(tmp_path, "rank", "runs/small")
    assert printed.splitlines()[0] == shown.splitlines()[0]
    assert printed.rstrip().splitlines()[-1] == shown.rstrip().splitlines()[-1]
    for found, expected in zip(rows(printed), rows(shown), strict=True):
        assert [found[at] for at in (0, 1, 2)] == [expected[at] for at in (0, 1, 2)]
        assert found[4].split(" (")[0] == expected[4].split(" (")[0]
        assert number(found[3]) == pytest.approx(number(expected[3]), abs=10.0)
    assert printed.splitlines()[0] in ran
    (at_rate,) = re.findall(r"```\n\$ codecbench rank runs/small --rate 1.55\n(.*?)```", PAGE, re.DOTALL)
    printed_at_rate = call(tmp_path, "rank", "runs/small", "--rate", "1.55")
    for found, expected in zip(rows(printed_at_rate), rows(at_rate), strict=True):
        assert [found[at] for at in (0, 1, 2, 4)] == [expected[at] for at in (0, 1, 2, 4)]
        assert found[5].split(" (")[0] == expected[5].split(" (")[0]
        assert float(found[3]) == pytest.approx(float(expected[3]), abs=0.03)
    (verdict,) = json.loads(call(tmp_path, "rank", "runs/small", "--format", "json"))
    assert [row[1] for row in verdict["rows"]] == ["jpeg2000", "jpeg", "jpeg_qf"]
    assert "| jpeg2000 |" in call(tmp_path, "rank", "runs/small", "--format", "markdown")


def number(text: str) -> float:
    return 0.0 if text == "–" else float(text.removesuffix(" %"))


def test_the_table_of_runs_is_what_intervals_say() -> None:
    lines = re.findall(r"^\| (\d) of (\d) \| (holds|cannot tell|fails)(.*)\|$", PAGE, re.MULTILINE)
    assert len(lines) == 5
    for successes, runs, verdict, rest in lines:
        standing = Standing("", 1.0, int(successes), int(runs))
        assert standing.verdict == verdict
        low, high = (round(100 * end) for end in standing.interval)
        more = {1: "one more", 3: "at least 3 more"}.get(standing.more_runs, "")
        assert {"holds": f"at least {low} %", "fails": f"at most {high} %", "cannot tell": more}[verdict] in rest
