"""SIGTERM, SIGHUP and SIGINT end every command in order, whatever it is at: with a status, a word and nothing left."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from distributions import install_source
from installed_command import TINY, Place, plain_place

from codecbench.cli.messages import ExitStatus

HANGING = """
import os
import subprocess
import time
from pathlib import Path

from codecbench import PluginSpec, hookimpl
from plain_plugins import ErrorEvaluator, Ramp


def hang():
    child = subprocess.Popen(["sleep", "300"])
    Path(os.environ["HANGING"]).write_text(f"{os.getpid()} {child.pid} ")
    time.sleep(300)


class Hanging(Ramp):
    name = "hanging"

    def open(self):
        hang()


class Weighing(ErrorEvaluator):
    name = "weighing"

    def compare(self, outcome, baseline):
        if "HANGING" in os.environ:
            hang()
        return iter(())


@hookimpl
def codecbench_datasets():
    return [PluginSpec("hanging", "stuck:Hanging", "never opens")]


@hookimpl
def codecbench_evaluators():
    return [PluginSpec("weighing", "stuck:Weighing", "never compares")]
"""

WAITING_IMPORT = """
import sys, time
def wait(event, arguments):
    if event == "import" and arguments[0] == "codecbench.cli":
        print("waiting", flush=True)
        time.sleep(60)
sys.addaudithook(wait)
"""

pytestmark = pytest.mark.thorough


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Place:
    """A folder with a matrix whose dataset never opens, and a run whose evaluator never compares."""
    place = plain_place(tmp_path_factory.mktemp("endings"))
    install_source(place.site, "stuck", "1", HANGING)
    (place.folder / "hanging.yaml").write_text(TINY.replace("use: ramp", "use: hanging"))
    (place.folder / "weighing.yaml").write_text(TINY.replace("tiny", "weighing").replace("[error]", "[weighing]"))
    (place.folder / "temporary").mkdir()
    assert place.call("run", "weighing.yaml", "--quiet").status == ExitStatus.SUCCESS
    return place


@pytest.fixture(autouse=True)
def not_under_nohup() -> Iterator[None]:
    """SIGHUP is heard, also where the tests themselves are run with nohup."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


def begun(place: Place, *words: str) -> tuple[subprocess.Popen[str], list[int]]:
    """The command when a plugin hangs in its host, and the processes of that host."""
    note = place.folder / "hanging"
    note.unlink(missing_ok=True)
    running = place.start(*words, HANGING=str(note), TMPDIR=str(place.folder / "temporary"))
    deadline = time.monotonic() + 60
    while not (note.exists() and note.read_text().endswith(" ")) and time.monotonic() < deadline:
        time.sleep(0.05)
    return running, [int(pid) for pid in note.read_text().split()]


def is_gone(pid: int) -> bool:
    try:
        return bool(psutil.Process(pid).status() == psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return True


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("words", ["run hanging.yaml", "table runs/weighing"])
def test_a_command_whose_plugin_hangs_leaves_nothing(place: Place, words: str, number: signal.Signals) -> None:
    running, host = begun(place, *words.split())
    running.send_signal(number)
    printed, said = running.communicate(timeout=30)
    assert (running.returncode, printed, said.strip()) == (ExitStatus.INTERRUPTED, "", "stopped")
    assert all(map(is_gone, host))
    assert list((place.folder / "temporary").iterdir()) == []


def test_what_a_killed_command_left_goes_with_the_next(place: Place) -> None:
    running, host = begun(place, "run", "hanging.yaml")
    running.kill()
    running.communicate()
    for pid in host:
        os.kill(pid, signal.SIGKILL)
    temporary = place.folder / "temporary"
    assert {path.name.rpartition("-")[0] for path in temporary.iterdir()} == {"codecbench-host"}
    anew = {"TMPDIR": str(temporary), "CODECBENCH_CACHE": str(place.folder / "cache")}  # so that it starts a host
    assert place.call("list", **anew).status == ExitStatus.SUCCESS
    assert list(temporary.iterdir()) == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_command_that_is_still_loading_is_stopped_as_well(tmp_path: Path, number: signal.Signals) -> None:
    place = Place(tmp_path)
    (place.site / "sitecustomize.py").write_text(WAITING_IMPORT)
    running = place.start("--help")
    assert running.stdout is not None
    assert running.stdout.readline() == "waiting\n"
    running.send_signal(number)
    _, said = running.communicate(timeout=30)
    assert (running.returncode, said) == (ExitStatus.INTERRUPTED, "stopped\n")


def test_under_nohup_a_closed_terminal_stops_nothing(place: Place) -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        running, host = begun(place, "run", "hanging.yaml")
    finally:
        signal.signal(signal.SIGHUP, before)
    running.send_signal(signal.SIGHUP)
    time.sleep(0.5)
    assert running.poll() is None
    assert not any(map(is_gone, host))
    running.terminate()
    assert running.communicate(timeout=30)[1].strip() == "stopped"
