"""Answers of children arrive whole, each from a process of its own, and whatever a child does costs its own answer."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from distributions import install_source

from codecbench.core.engine.scouting import answers_of_children


def line(value: object) -> bytes:
    return json.dumps({"value": value}).encode() + b"\n"


LONG_S = 500.0


def ended(action: Callable[[], object]) -> dict[str, object]:
    """What is answered for a child that does this, beside one that is well."""
    answers = answers_of_children({"bad": lambda: line(action()), "good": lambda: line(1)}, LONG_S)
    assert answers["good"] == {"value": 1}
    return answers["bad"]


def test_each_answers_from_a_process_of_its_own() -> None:
    answers = answers_of_children({name: lambda: line(os.getpid()) for name in "abc"}, LONG_S)
    pids = {answer["value"] for answer in answers.values()}
    assert len(pids | {os.getpid()}) == 4
    assert list(answers) == ["a", "b", "c"]


def test_they_are_elsewhere_and_silent(capfd: pytest.CaptureFixture[str]) -> None:
    def where() -> bytes:
        os.write(1, b"hello")
        Path("left behind").write_text("here")
        return line([os.getcwd(), tempfile.gettempdir(), os.getsid(0)])

    folder, temporary, session = answers_of_children({"a": where}, LONG_S)["a"]["value"]
    assert folder == temporary != os.getcwd()
    assert session != os.getsid(0)
    assert not Path(folder).exists()
    assert capfd.readouterr().out == ""


def test_threads_are_counted() -> None:
    """In a process of its own: a library of another test may start its threads again in a child that is forked."""
    script = (
        "import threading\n"
        "from codecbench.core.engine.scouting import is_single_threaded\n"
        "before, stop = is_single_threaded(), threading.Event()\n"
        "threading.Thread(target=stop.wait).start()\n"
        "print(before, is_single_threaded())\n"
        "stop.set()\n"
    )
    variables = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    done = subprocess.run([sys.executable, "-c", script], env=variables, capture_output=True, text=True, timeout=300)
    assert done.stdout.split() == ["True", "False"], done.stderr


def test_a_long_answer_arrives_whole() -> None:
    assert answers_of_children({"a": lambda: line("x" * 3_000_000)}, LONG_S) == {"a": {"value": "x" * 3_000_000}}


def test_a_child_that_ends_itself_is_told_by_its_status() -> None:
    assert ended(lambda: os._exit(3))["text"] == "it ended its process with status 3"
    assert ended(lambda: os.kill(os.getpid(), signal.SIGKILL))["text"] == "it ended its process by SIGKILL"


def test_a_child_that_raises_has_no_answer() -> None:
    assert ended(lambda: 1 / 0)["text"] == "it ended its process with status 0"


def test_a_child_that_hangs_is_ended_with_its_children(alive: Alive) -> None:
    def hang() -> bytes:
        os.open(alive.path, os.O_WRONLY)
        os.fork()
        time.sleep(3600)
        return b""

    assert answers_of_children({"bad": hang}, 0.8)["bad"]["text"] == "no answer within 0.8 s"
    alive.wait_for_the_last()


@dataclass
class Alive:
    """A pipe that processes hold open as long as they live."""

    path: Path
    reading: int

    def wait_for_the_last(self) -> None:
        os.set_blocking(self.reading, True)
        assert os.read(self.reading, 1) == b"", "this comes with the end of the last that wrote"


@pytest.fixture
def alive(tmp_path: Path) -> Iterator[Alive]:
    path = tmp_path / "alive"
    os.mkfifo(path)
    reading = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    yield Alive(path, reading)
    os.close(reading)


@pytest.mark.parametrize("interrupted", [pytest.param(False, marks=pytest.mark.thorough), True])
def test_a_listing_leaves_nobody_behind(tmp_path: Path, alive: Alive, interrupted: bool) -> None:
    """A child of the one that hangs is left where a slow machine cannot end both in the seconds after an interrupt."""
    begun = tmp_path / "begun"
    source = f"import os, time\nos.open({str(alive.path)!r}, os.O_WRONLY)\nopen({str(begun)!r}, 'w').close()\n"
    install_source(tmp_path, "hanging", "1", source + ("" if interrupted else "os.fork()\n") + "time.sleep(3600)\n")
    limit = "600" if interrupted else "0.5"
    environment = {**os.environ, "PYTHONPATH": str(tmp_path), "CODECBENCH_PLUGIN_TIMEOUT_S": limit}
    command = [sys.executable, "-m", "codecbench", "list"]
    program = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while not begun.exists() and program.poll() is None:
        time.sleep(0.02)
    if interrupted:
        program.send_signal(signal.SIGINT)
    _, said = program.communicate(timeout=300)
    assert program.returncode == (130 if interrupted else 0), said
    said = " ".join(said.split())
    assert ("hanging 1" in said and "no answer within 0.5 s" in said) is not interrupted
    alive.wait_for_the_last()


def test_what_is_no_answer_is_none() -> None:
    answers = answers_of_children({"list": lambda: b"[1]\n", "text": lambda: b"hello\n"}, LONG_S)
    assert {"error", "text"} == answers["list"].keys() == answers["text"].keys()
