"""Answers of children arrive whole, each from a process of its own, and whatever a child does costs its own answer."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest
from distributions import install_source

from codecbench.core.engine.scouting import answers_of_children


def line(value: object) -> bytes:
    return json.dumps({"value": value}).encode() + b"\n"


def ended(action: Callable[[], object]) -> dict[str, object]:
    """What is answered for a child that does this, beside one that is well."""
    answers = answers_of_children({"bad": lambda: line(action()), "good": lambda: line(1)}, 0.8)
    assert answers["good"] == {"value": 1}
    return answers["bad"]


def test_each_answers_from_a_process_of_its_own() -> None:
    answers = answers_of_children({name: lambda: line(os.getpid()) for name in "abc"}, 20.0)
    pids = {answer["value"] for answer in answers.values()}
    assert len(pids | {os.getpid()}) == 4
    assert list(answers) == ["a", "b", "c"]


def test_they_are_elsewhere_and_silent(capfd: pytest.CaptureFixture[str]) -> None:
    def where() -> bytes:
        os.write(1, b"hello")
        Path("left behind").write_text("here")
        return line([os.getcwd(), tempfile.gettempdir(), os.getsid(0)])

    folder, temporary, session = answers_of_children({"a": where}, 20.0)["a"]["value"]
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
    done = subprocess.run([sys.executable, "-c", script], env=variables, capture_output=True, text=True, timeout=60)
    assert done.stdout.split() == ["True", "False"], done.stderr


def test_a_long_answer_arrives_whole() -> None:
    assert answers_of_children({"a": lambda: line("x" * 3_000_000)}, 20.0) == {"a": {"value": "x" * 3_000_000}}


def test_a_child_that_ends_itself_is_told_by_its_status() -> None:
    assert ended(lambda: os._exit(3))["text"] == "it ended its process with status 3"
    assert ended(lambda: os.kill(os.getpid(), signal.SIGKILL))["text"] == "it ended its process by SIGKILL"


def test_a_child_that_raises_has_no_answer() -> None:
    assert ended(lambda: 1 / 0)["text"] == "it ended its process with status 0"


def test_a_child_that_hangs_is_ended_with_its_children() -> None:
    def hang() -> None:
        if os.fork() == 0:
            time.sleep(3600)
        time.sleep(3600)

    begun = time.monotonic()
    assert ended(hang)["text"] == "no answer within 0.8 s"
    assert time.monotonic() - begun < 10
    time.sleep(0.1)
    left = [child for child in psutil.Process().children(recursive=True) if child.status() != psutil.STATUS_ZOMBIE]
    assert not [child for child in left if child.cmdline() == psutil.Process().cmdline()]


@pytest.mark.parametrize("interrupted", [False, True])
def test_a_listing_leaves_nobody_behind(tmp_path: Path, interrupted: bool) -> None:
    begun, mark = tmp_path / "begun", f"hanging-{tmp_path.name}"
    source = f"import os, time\nopen({str(begun)!r}, 'w').close()\nos.fork()\ntime.sleep(3600)\n"
    install_source(tmp_path, "hanging", "1", source)
    limit = "60" if interrupted else "0.5"
    environment = {**os.environ, "PYTHONPATH": str(tmp_path), "MARK": mark, "CODECBENCH_PLUGIN_TIMEOUT_S": limit}
    command = [sys.executable, "-m", "codecbench", "list"]
    program = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while not begun.exists() and program.poll() is None:
        time.sleep(0.02)
    if interrupted:
        program.send_signal(signal.SIGINT)
    _, said = program.communicate(timeout=20)
    assert program.returncode == (130 if interrupted else 0), said
    assert ("hanging 1" in said and "no answer within 0.5 s" in said) is not interrupted
    time.sleep(0.1)
    assert [process.pid for process in psutil.process_iter(["environ"]) if has_mark(process, mark)] == []


def has_mark(process: psutil.Process, mark: str) -> bool:
    return (process.info["environ"] or {}).get("MARK") == mark and process.status() != psutil.STATUS_ZOMBIE


def test_what_is_no_answer_is_none() -> None:
    answers = answers_of_children({"list": lambda: b"[1]\n", "text": lambda: b"hello\n"}, 20.0)
    assert {"error", "text"} == answers["list"].keys() == answers["text"].keys()
