"""What a user does with codecbench, in small: the installed command, in a process of its own, with plugins of others.

Other files look closer, most of them in the thorough tier; this one says that nothing is broken from end to end.
"""

from __future__ import annotations

import re
import time
from pathlib import Path

import pytest
from distributions import install_source
from installed_command import TINY, Done, Place, plain_place
from recordings import pictures

CRASHING = """
import os, signal
from plain_plugins import NULL_TRACE, Shift
from codecbench import Capabilities, PluginSpec, hookimpl

class Crashing(Shift):
    name = "crashing"
    capabilities = Capabilities(channels=(1, 3))
    def encode(self, image, *, trace=NULL_TRACE):
        return image.tobytes()
    def decode(self, bitstream, *, trace=NULL_TRACE):
        if self.params.bits == 0:
            raise RuntimeError("broken on purpose")
        os.kill(os.getpid(), signal.SIGSEGV)

@hookimpl
def codecbench_codecs():
    return [PluginSpec("crashing", "crashing:Crashing", "raises, or dies")]
"""
GATED = """
import os, time
from pathlib import Path
from plain_plugins import ErrorEvaluator, NULL_TRACE, Shift
from codecbench import PluginSpec, hookimpl

def note(line):
    with open(Path(os.environ["GATE"]) / "done", "a") as file:
        file.write(line)

class Noting(Shift):
    name = "noting"
    def encode(self, image, *, trace=NULL_TRACE):
        if image[0, 0] == 0:
            note(f"encoded {self.params.bits}\\n")
        return super().encode(image)

class Gated(ErrorEvaluator):
    name = "gated"
    def evaluate(self, coded):
        bits = coded.bitstream[2]
        if bits == 3 and not (Path(os.environ["GATE"]) / "open").exists():
            (Path(os.environ["GATE"]) / "waiting").touch()
            time.sleep(3600)
        if coded.original.index == 0:
            note(f"measured {bits}\\n")
        yield from super().evaluate(coded)

@hookimpl
def codecbench_codecs():
    return [PluginSpec("noting", "gated:Noting", "says what it encodes")]

@hookimpl
def codecbench_evaluators():
    return [PluginSpec("gated", "gated:Gated", "waits where it is to be interrupted")]
"""
SMALL = """
version: 1
name: small
sequences: [{use: synthetic, params: {stop: 10, scale: 0.15}}]
codecs:
  - {use: jpeg, params: {quality: {grid: [10, 50, 90]}}}
  - {use: jpeg2000, params: {cr_percent: {grid: [80, 90, 97]}}}
  - {use: crashing, params: {bits: {grid: [0, 1]}}}
  - absent
evaluators: [quality, delivery]
run: {workers: 1}
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Place:
    """The plain plugins, and those that crash, wait and write down what they do, as distributions of others."""
    place = plain_place(tmp_path_factory.mktemp("whole"))
    install_source(place.site, "crashing", "1", CRASHING)
    install_source(place.site, "gated", "1", GATED)
    return place


def succeeded(place: Place, *words: str, **variables: str) -> str:
    done = place.call(*words, timeout=600, **variables)
    assert done.status == 0, done.output
    return done.stdout


@pytest.fixture(scope="module")
def ran(place: Place) -> Done:
    """What the small matrix says as it is run."""
    (place.folder / "small.yaml").write_text(SMALL)
    return place.call("run", "small.yaml", timeout=600)


@pytest.fixture(scope="module")
def run(ran: Done) -> str:
    """Its run folder."""
    assert "run folder: runs/small" in ran.stdout, ran.output
    return "runs/small"


def test_a_crashing_codec_is_rows_and_an_exit_status_and_the_rest_is_computed(ran: Done) -> None:
    """Nine settings, each with a cell of quality and five of delivery, which decodes nothing."""
    assert ran.status == 1, ran.output
    assert "Traceback" not in ran.output
    assert "cells: 1 crashed, 1 failed, 46 ok, 6 unsupported" in ran.stdout
    assert "codec crashing of crashing 1: decode, frame 0: RuntimeError: broken on purpose" in ran.stderr
    died = r"^crashed: synthetic \| crashing bits=1 .*codec crashing of crashing 1: .*it ended its process by SIGSEGV$"
    assert re.search(died, ran.stderr, re.MULTILINE)
    table = ran.stdout.partition("Every setting of small\n")[2].partition("\nIn all rows: sequence synthetic")[0]
    rows = [line.split()[:2] for line in table.splitlines()[1:]]
    assert sorted(rows) == sorted([
        *(["jpeg", f"quality={value}"] for value in (10, 50, 90)),
        *(["jpeg2000", f"cr_percent={value}"] for value in (80, 90, 97)),
        ["crashing", "bits=0"], ["crashing", "bits=1"], ["absent", "–"],
    ])  # fmt: skip


def test_a_run_that_was_killed_goes_on_and_computes_nothing_twice(place: Place, tmp_path: Path) -> None:
    """It is killed when one cell hangs and all that came before it is recorded."""
    codecs = "[{use: noting, params: {bits: {grid: [0, 1, 3]}}}]"
    text = TINY.replace("[shift]", codecs).replace("[error]", "[gated]").replace("tiny", "killed")
    (place.folder / "killed.yaml").write_text(text)
    out, notes = place.folder / "runs" / "killed", tmp_path / "done"

    def recorded() -> bool:
        said = notes.read_text() if (tmp_path / "waiting").exists() else ""
        files = len(list(out.glob("coded/*.bits"))), len(list(out.glob("records/*/*/record.json")))
        return bool(said) and files == (said.count("encoded"), said.count("measured"))

    running = place.start("run", "killed.yaml", GATE=str(tmp_path))
    while not recorded():
        assert running.poll() is None, running.communicate()
        time.sleep(0.05)
    running.kill()
    running.communicate()
    assert sorted(notes.read_text().split("\n")[:-1]) == [
        "encoded 0", "encoded 1", "encoded 3", "measured 0", "measured 1",
    ]  # fmt: skip
    (tmp_path / "open").touch()
    assert "cells: 3 ok, 2 of them from before" in succeeded(place, "run", "killed.yaml", GATE=str(tmp_path))
    assert notes.read_text().endswith("measured 3\n")
    assert len(notes.read_text().split("\n")[:-1]) == 6, "the last cell is all that was computed"


def test_a_task_that_every_setting_does_alike_ranks_nobody(place: Place, run: str) -> None:
    """Over the ideal link every frame is there at once."""
    said = succeeded(place, "rank", run, "--all")
    assert "synthetic: pictures on time\nUninformative here: " in said


def test_a_setting_is_chosen_for_a_link(place: Place, run: str) -> None:
    said = succeeded(place, "choose", run, "--link", "ideal", "--deadline", "10ms")
    assert "Over ideal use jpeg2000 cr_percent=97" in said


def test_a_report_is_a_page(place: Place, run: str) -> None:
    assert "report.html" in succeeded(place, "report", run, "--frames", "1")
    page = (place.folder / run / "report" / "report.html").read_text()
    assert "<html" in page
    assert "jpeg2000" in page


def test_a_bundle_is_the_run_which_is_computed_again_to_the_bit(place: Place, run: str) -> None:
    assert "54 cells (1 crashed, 1 failed, 46 ok, 6 unsupported)" in succeeded(
        place, "bundle", run, "--out", "small.zip"
    )
    assert re.search(r"^[1-9]\d* to the bit", succeeded(place, "verify-run", "small.zip"), re.MULTILINE)


def test_a_recording_is_tried(place: Place) -> None:
    pictures(place.folder / "recording", [f"{number}.png" for number in range(3)])
    words = ["try", "recording", "--codec", "jpeg:10", "--for", "speed", "--workers", "1", "--out", "tried"]
    done = place.call(*words, timeout=600)
    assert done.status == 0, done.output
    assert "folder of pictures, 3 frames, 48x32" in done.output
    (report,) = re.findall(r"the report: file://(.*)", done.output)
    assert Path(report).stat().st_size > 10_000
