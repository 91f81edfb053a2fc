"""A run folder from elsewhere: nothing it names is opened, no link is followed out, text is only text."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest
from distributions import install_source, register
from project import SUPPORT
from warm_command import run_warm

from codecbench.core.engine.identity import digest
from codecbench.core.engine.storage.environment import environment_id
from codecbench.core.engine.text import LINE_LIMIT, clean_line, clean_text
from codecbench.core.report.tables import escape

pytestmark = pytest.mark.thorough

MATRIX = """
version: 1
name: small
sequences: [{use: folder, params: {path: pictures}}]
codecs: [png, {use: jpeg, params: {quality: {grid: [20, 60]}}}]
evaluators: [quality]
run: {workers: 1}
"""
FOREIGN = """
from codecbench import (
    NULL_TRACE, Capabilities, Codec, FrameEvaluator, Measurement, Metric, Params, PluginSpec, hookimpl,
)


class LoudParams(Params):
    length: int = 10


class Loud(Codec[LoudParams]):
    name = "loud"
    version = "1"
    params_type = LoudParams
    capabilities = Capabilities(channels=(1, 3))

    def encode(self, image, *, trace=NULL_TRACE):
        text = "\\x1b]0;owned\\x07 [red]x[/] | ![p](http://x/y.png) <img src=x onerror=alert(1)> \\\\input{x} \\u202e"
        raise ValueError(text + "a" * self.params.length)

    def decode(self, bitstream, *, trace=NULL_TRACE):
        raise ValueError("nothing to decode")


class ManyParams(Params):
    kind: str = "whole"
    count: int = 1_000_000


class Many(FrameEvaluator[ManyParams]):
    name = "many"
    version = "1"
    params_type = ManyParams
    metrics = (Metric("value", "1", "neither", "a number"),)

    def evaluate(self, coded):
        for number in range(self.params.count):
            stage = f"encode/{number}" if self.params.kind == "stages" else None
            yield Measurement("value", float(number), stage=stage)


@hookimpl
def codecbench_codecs():
    return [PluginSpec("loud", "loud:Loud", "fails"), PluginSpec("gone", "loud:Lound", "is not there")]


@hookimpl
def codecbench_evaluators():
    return [PluginSpec("many", "loud:Many", "yields many")]


@hookimpl
def codecbench_surprises():
    return []
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a site of plugins, three pictures, a matrix, and a run of it."""
    folder = tmp_path_factory.mktemp("foreign")
    (folder / "site").mkdir()
    shutil.copy(SUPPORT / "plain_plugins.py", folder / "site")
    register(folder / "site", "plain", "1", "plain_plugins")
    install_source(folder / "site", "loud", "1", FOREIGN)
    (folder / "pictures").mkdir()
    rng = np.random.default_rng(1)
    for number in range(3):
        cv2.imwrite(str(folder / "pictures" / f"{number}.png"), rng.integers(0, 256, (40, 60, 3), np.uint8))
    (folder / "small.yaml").write_text(MATRIX)
    assert command(folder, "run", "small.yaml", "--out", "whole", "--quiet").returncode == 0
    return folder


@pytest.fixture
def run(place: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(place / "whole", tmp_path / "run"))


def command(place: Path, *words: str | Path, **variables: str) -> subprocess.CompletedProcess[str]:
    cache = str(place / "cache")
    environment = {**os.environ, "PYTHONPATH": str(place / "site"), "CODECBENCH_CACHE": cache, **variables}
    done = run_warm(words, place, environment)
    assert "Traceback" not in done.stderr + done.stdout, done.stderr + done.stdout
    return done


def pictures(run: Path) -> int:
    """Of how many settings a report's page shows frames."""
    html = (run / "report" / "report.html").read_text()
    data = json.loads(re.search(r'id="data">(.*?)</script>', html, re.DOTALL).group(1))
    return len({(frame["codec"], frame["setting"]) for frame in data["frames"]})


def test_pictures_of_a_run_made_here(run: Path, place: Path) -> None:
    assert command(place, "report", run).returncode == 0
    assert pictures(run) == 3


def test_what_a_plan_from_elsewhere_names_is_opened_only_when_asked(run: Path, place: Path, tmp_path: Path) -> None:
    elsewhere = {"CODECBENCH_CACHE": str(tmp_path / "cache")}  # another user's, with another key
    done = command(place, "report", run, **elsewhere)
    assert done.returncode == 0
    assert "run was made in" in done.stderr
    assert "--sequences-from" in done.stderr
    assert pictures(run) == 0
    command(place, "report", run, "--sequences-from", "same", **elsewhere)
    assert pictures(run) == 3
    shutil.copytree(place / "pictures", tmp_path / "mine" / "pictures")
    command(place, "report", run, "--sequences-from", tmp_path / "mine", **elsewhere)
    assert pictures(run) == 3
    done = command(place, "report", run, "--sequences-from", tmp_path / "cache", **elsewhere)
    assert f"pictures is not in {tmp_path / 'cache'}" in done.stderr
    assert pictures(run) == 0


def test_without_bitstreams_no_sequence_is_asked_for(run: Path, place: Path, tmp_path: Path) -> None:
    shutil.rmtree(run / "coded")
    done = command(place, "report", run, CODECBENCH_CACHE=str(tmp_path / "cache"))
    assert done.returncode == 0
    assert "no bitstreams" in done.stderr
    assert "--sequences-from" not in done.stderr


def test_the_name_of_an_own_folder_does_not_make_a_plan_ones_own(run: Path, place: Path) -> None:
    document = json.loads((run / "plan.json").read_text())
    document["plan"]["sequences"][0]["dataset"]["params"]["path"] = "/etc"
    content = {"plan": document["plan"], "origin": document["origin"]}
    (run / "plan.json").write_text(json.dumps({"checksum": digest(content), **content}))
    done = command(place, "report", run)
    assert "are not opened" in done.stderr
    assert pictures(run) == 0


def test_no_new_frames_are_shown_beside_old_bitstreams(run: Path, place: Path, tmp_path: Path) -> None:
    changed = shutil.copytree(place / "pictures", tmp_path / "mine" / "pictures")
    cv2.imwrite(str(changed / "1.png"), np.zeros((40, 60, 3), np.uint8))
    done = command(place, "report", run, "--sequences-from", tmp_path / "mine")
    assert "pictures has changed" in done.stderr
    assert pictures(run) == 0


@pytest.mark.parametrize(
    "what",
    [
        *("lock", "report", "coded", "record"),
        *(
            pytest.param(what, marks=pytest.mark.slow)
            for what in (
                "page",
                "run.log",
                "plan.json",
                "matrix.yaml",
                "file",
                "environment",
                "records",
                "index",
                "shard",
            )
        ),
    ],
)
def test_no_link_is_followed_out_of_a_run_folder(what: str, run: Path, place: Path, tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    record = next(run.glob("records/*/*"))
    (run / "report").mkdir(exist_ok=True)
    places = {
        "record": record,
        "shard": record.parent,
        "page": run / "report" / "report.html",
        "index": run / "records" / "index.jsonl",
    }
    path = {**places, "file": next(run.glob("coded/*.bits"))}.get(what, run / what)
    is_file = what == "page" or path.is_file()
    if path.is_dir():
        shutil.rmtree(path)
    path.unlink(missing_ok=True)
    target = outside / "thesis.txt" if is_file else outside
    (outside / "thesis.txt").write_text("a year's work")
    path.symlink_to(target)
    for words in (["report", run], ["run", "small.yaml", "--out", run], ["plan", "small.yaml", "--out", run]):
        done = command(place, *words)
        assert done.returncode == 2, done.stdout
        assert str(path) in done.stderr
        assert f"link to {target}," in done.stderr
    assert [(path.name, path.read_text()) for path in outside.iterdir()] == [("thesis.txt", "a year's work")]


def test_a_pipe_or_a_link_in_place_of_a_record_costs_that_record(run: Path, place: Path) -> None:
    first, second, *_ = sorted(run.glob("records/*/*/record.json"))
    for path in (first, second):
        path.unlink()
    os.mkfifo(first)
    second.symlink_to("/etc/hostname")
    done = command(place, "table", run)
    assert done.returncode == 0
    assert "not a plain file" in done.stderr
    assert "it is a link" in done.stderr
    assert command(place, "run", "small.yaml", "--out", run, "--quiet").returncode == 0
    assert command(place, "table", run).stderr == ""


@pytest.fixture(scope="module")
def loud(place: Path) -> Path:
    """A run whose every reason is what a codec had to say."""
    text = MATRIX.replace("{use: jpeg, params: {quality: {grid: [20, 60]}}}", "{use: loud, params: {length: 5000000}}")
    (place / "loud.yaml").write_text(text)
    done = command(place, "run", "loud.yaml", "--out", "loud")
    assert done.returncode == 1
    assert_clean(done.stdout + done.stderr)
    return place / "loud"


def assert_clean(text: str) -> None:
    assert not re.search(r"[\x00-\x08\x0b-\x1f\x7f\u202e]", text)
    assert len(text) < 50_000


def test_what_a_codec_says_is_shown_cleaned_and_cut(loud: Path, place: Path) -> None:
    assert (loud / "run.log").stat().st_size < 20_000
    for words in (["table", "loud"], ["status", "--failed", "loud"], ["table", "--tidy", "--format", "csv", "loud"]):
        done = command(place, *words)
        assert_clean(done.stdout + done.stderr)
        assert "owned" in done.stdout
        assert words[0] == "status" or "[red]x[/]" in done.stdout.replace("\n", "")
    shown = command(place, "table", "--all", "--format", "markdown", "loud").stdout
    assert_clean(shown)
    assert "!\\[p\\](http" in shown
    assert "&lt;img src" in shown
    assert command(place, "report", "loud").returncode == 0
    html = (loud / "report" / "report.html").read_text()
    assert len(html) < 8_000_000
    assert "<img src=x" not in html
    latex = command(place, "table", "--all", "--format", "latex", "loud").stdout
    assert "\\textbackslash{}\\textbackslash{}" not in latex
    assert "\\textbackslash{}x1b" in latex


EVIL = "=cmd|calc \x1b[31m\u202ered</script><img src=x onerror=alert(1)> [l](javascript:x) `c` \\input{x} ${{7*7}} \x07"


def spoil(run: Path) -> None:
    """Put hostile text wherever a plan, records and environments have text, with the checksums that belong to it."""
    plan = json.loads((run / "plan.json").read_text())
    body = plan["plan"]
    body["matrix_text"] = EVIL * 100_000
    body["sequences"][0]["name"] = EVIL
    for number, setting in enumerate(body["settings"]):
        setting["label"] = f"{EVIL} {number}"
    content = {"plan": body, "origin": plan["origin"]}
    (run / "plan.json").write_text(json.dumps({"checksum": digest(content), **content}))
    for path in run.glob("records/*/*/record.json"):
        record = json.loads(path.read_text())
        del record["checksum"]
        record["worker"] = {"host": EVIL, "confined": EVIL}
        record["summaries"].append([f"{EVIL} metric", EVIL, "mean", 2.0])
        if record["cell"]["codec"]["name"] == "jpeg":
            record |= {"status": "failed", "reason": EVIL + "A" * 5_000_000, "traceback": EVIL}
        path.write_text(json.dumps({"checksum": digest(record), **record}))
    (run / "records" / "index.jsonl").unlink()
    (path,) = run.glob("environment/*.json")
    environment = json.loads(path.read_text())["environment"]
    environment["machine"]["cpu"] = EVIL * 1000
    described = {"id": environment_id(environment), "environment": environment}
    path.unlink()
    path.with_stem(described["id"]).write_text(json.dumps({"checksum": digest(described), **described}))


@pytest.mark.slow
def test_hostile_text_of_a_folder_is_text_wherever_it_is_shown(run: Path, place: Path, tmp_path: Path) -> None:
    spoil(run)
    formats = [["--format", name] for name in ("csv", "json", "markdown", "latex")]
    commands = [["table", run], *([["table", run, *words] for words in formats])]
    commands += [["table", "--tidy", run, "--format", "csv"], ["status", "--failed", run], ["status", "--json", run]]
    commands += [["compare", place / "whole", run, "--all", "--fail-on", "never", *words] for words in ([], formats[2])]
    for words in commands:
        done = command(place, *words)
        assert done.returncode == 0, done.stderr
        assert not re.search(r"[\x00-\x08\x0b-\x1f\x7f\u202e]", done.stdout + done.stderr), words
        assert len(done.stdout) < 60_000, words
        assert "markdown" not in words or not re.search(r"<img|[^\\]\[l|[^\\]`c", done.stdout)
        assert "csv" not in words or not re.search(r"(^|,)\"?=", done.stdout, re.MULTILINE)
    assert command(place, "table", run, "--format", "csv").stdout.count("'=cmd") > 3
    assert command(place, "report", run).returncode == 0
    page = (run / "report" / "report.html").read_text()
    assert len(page) < 8_000_000
    assert "<img src=x" not in page
    assert page.count("</script>") == 3
    assert "\u202e" not in page
    assert command(place, "plot", run, "--out", tmp_path / "figures").returncode == 0
    drawn = list((tmp_path / "figures").iterdir())
    assert drawn
    assert "<img" not in "".join(path.read_text() for path in drawn)
    assert command(place, "reproduce", run, "--out", tmp_path / "paper.md").returncode == 0
    assert not re.search(r"<img|[^\\]\[l", (tmp_path / "paper.md").read_text())


def test_a_plan_whose_name_is_a_path_is_refused(run: Path, place: Path, tmp_path: Path) -> None:
    plan = json.loads((run / "plan.json").read_text())
    plan["plan"]["name"] = str(tmp_path / "elsewhere")
    content = {"plan": plan["plan"], "origin": plan["origin"]}
    (run / "plan.json").write_text(json.dumps({"checksum": digest(content), **content}))
    done = command(place, "reproduce", place / "whole", run, "--out", tmp_path / "paper.md")
    assert done.returncode == 3
    assert "json is damaged" in done.stderr
    assert not (tmp_path / "elsewhere").exists()


def test_text_is_cleaned_without_confusing_what_differs() -> None:
    assert clean_line("two\nlines\ta bell\a") == "two lines a bell\\x07"
    assert clean_text("two\nlines\x1b[2J") == "two\nlines\\x1b[2J"
    assert clean_line("\ud800\u202e") == "\\ud800\\u202e"
    long, other = clean_line("a" * 5000 + "b"), clean_line("a" * 5000 + "c")
    assert long != other
    assert len(long) < LINE_LIMIT + 100
    assert "5,001 characters" in long
    assert clean_line(long) == long or len(clean_line(long)) < LINE_LIMIT + 100
    assert escape("`a` <b> [c](d) *e* \\f & |") == "\\`a\\` &lt;b> \\[c\\](d) \\*e\\* \\\\f &amp; |"


@pytest.mark.thorough
@pytest.mark.parametrize(("kind", "words"), [("whole", "more than 3,000 measurements"), ("stages", "more than 1,000")])
def test_a_cell_that_measures_without_end_fails_with_the_bound(
    kind: str, words: str, place: Path, tmp_path: Path
) -> None:
    text = MATRIX.replace("evaluators: [quality]", f"evaluators: [{{use: many, params: {{kind: {kind}}}}}]")
    (place / "many.yaml").write_text(text)
    done = command(place, "run", "many.yaml", "--out", tmp_path / "many", "--quiet")
    assert done.returncode == 1
    assert f"value: {words}" in done.stderr


def test_a_run_says_which_plugins_were_left_out(place: Path, tmp_path: Path) -> None:
    done = command(place, "run", "small.yaml", "--out", tmp_path / "run", "--quiet")
    assert "left out: loud 1" in done.stderr
    assert "implements codecbench_surprises" in done.stderr
    (place / "gone.yaml").write_text(MATRIX.replace("[png,", "[gone,"))
    done = command(place, "run", "gone.yaml", "--out", tmp_path / "gone")
    assert done.returncode == 0, "the other codec's cells are there"
    shown = command(place, "table", tmp_path / "gone", "--format", "csv")
    assert "no Lound; " in shown.stdout
    assert "mean Loud?" in shown.stdout
