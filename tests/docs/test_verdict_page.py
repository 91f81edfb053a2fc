"""docs/verdict.md shows what `codecbench rank` prints of the run that it shows."""

from __future__ import annotations

import json
import os
import re
import subprocess
from pathlib import Path

import pytest
from installed_command import COMMAND
from project import DOCS

from codecbench.core.analysis.passing import Standing

PAGE = (DOCS / "verdict.md").read_text()


def call(folder: Path, *words: str) -> str:
    environment = {name: value for name, value in os.environ.items() if name != "COLUMNS"}
    done = subprocess.run(
        [str(COMMAND), *words], cwd=folder, capture_output=True, text=True, timeout=600, env=environment
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def rows(text: str) -> list[list[str]]:
    """Cells of the lines that begin with a codec."""
    return [re.split(r"  +", line.strip()) for line in text.splitlines() if re.match(r"jpeg\w* {2,}\S", line)]


def names(cell: str) -> list[str]:
    """Of `jpeg (-8 % ± 1), raw (-9 % ± 2)`."""
    return re.findall(r"(\w+) \(", cell)


def number(text: str) -> float:
    return 0.0 if text == "–" else float(text.partition(" %")[0])


@pytest.mark.thorough
def test_the_example_is_what_is_printed(tmp_path: Path) -> None:
    """Orders, claims and settings; the rates to ten per cent, for they depend on the codecs' libraries."""
    (matrix,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    (behind, picks) = (re.findall(rf"```\n\$ codecbench rank runs/small{words}\n(.*?)```", PAGE, re.DOTALL)[0]
                       for words in (" --all", ""))  # fmt: skip
    (tmp_path / "small.yaml").write_text(matrix)
    ran = call(tmp_path, "run", "small.yaml")
    printed = call(tmp_path, "rank", "runs/small", "--all")
    ranking, _, brief = printed.partition("\n\n")
    assert ranking.splitlines()[0] == behind.splitlines()[0]
    assert sentences(ranking) == sentences(behind)
    for found, expected in zip(rows(ranking), rows(behind), strict=True):
        assert (found[0], names(found[2])) == (expected[0], names(expected[2]))
        assert number(found[1]) == pytest.approx(number(expected[1]), abs=10.0)
    assert brief == call(tmp_path, "rank", "runs/small")
    assert ran.endswith(brief)
    assert sentences(brief) == sentences(picks)
    for found, expected in zip(rows(brief), rows(picks), strict=True):
        assert (found[0], found[1], found[-1]) == (expected[0], expected[1], expected[-1])
        assert float(found[2]) == pytest.approx(float(expected[2]), rel=0.1)
    (at_rate,) = re.findall(r"```\n\$ codecbench rank runs/small --rate 1.55\n(.*?)```", PAGE, re.DOTALL)
    printed_at_rate = call(tmp_path, "rank", "runs/small", "--rate", "1.55")
    assert sentences(printed_at_rate) == sentences(at_rate)
    for found, expected in zip(rows(printed_at_rate), rows(at_rate), strict=True):
        assert (found[0], found[2], names(found[4])) == (expected[0], expected[2], names(expected[4]))
        assert float(found[1]) == pytest.approx(float(expected[1]), abs=0.03)
        assert number(found[3]) == pytest.approx(number(expected[3]), abs=10.0)
    verdict, table, answer = json.loads(call(tmp_path, "rank", "runs/small", "--format", "json"))
    assert [row[0] for row in verdict["rows"]] == ["jpeg2000", "jpeg", "jpeg_qf"]
    assert [row[0] for row in table["rows"]] == ["jpeg", "jpeg2000"]
    assert answer["sentences"] == [brief.splitlines()[-1]]
    assert "| jpeg2000 |" in call(tmp_path, "rank", "runs/small", "--format", "markdown")


def sentences(text: str) -> list[str]:
    """Lines below the table without what depends on libraries: rates, and as how many frames they count."""
    lines = [line for line in text.splitlines() if line.rstrip().endswith(".")]
    varying = r"about \d+|\([+-]\d.*? vs\. |\d[\d.]* (?:Mbit/s|GB/h|%)|0\.\d+ ± [\d.]+"
    return [re.sub(varying, "", line) for line in lines]


def test_the_table_of_runs_is_what_intervals_say() -> None:
    lines = re.findall(r"^ *\| (\d) of (\d) \| (passes|inconclusive|fails)(.*)\|$", PAGE, re.MULTILINE)
    assert len(lines) == 5
    for successes, runs, verdict, rest in lines:
        standing = Standing("", 1.0, int(successes), int(runs))
        assert standing.verdict == verdict
        low, high = (round(100 * end) for end in standing.interval)
        more = {1: "one more", 3: "at least 3 more"}.get(standing.more_runs, "")
        assert {"passes": f"at least {low} %", "fails": f"at most {high} %", "inconclusive": more}[verdict] in rest
