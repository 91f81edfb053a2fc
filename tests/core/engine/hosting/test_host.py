"""A host answers with data, and whatever goes wrong in it costs the question that was asked."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.engine.hosting.host import LIMIT_VARIABLE, PluginFault, PluginHost, PluginLoss, PluginTimeout


def where(_: object) -> list[Any]:
    return [os.getpid(), os.getcwd()]


def double(_: object, value: Any) -> Any:
    return 2 * value


def leave(_: object, status: int) -> None:
    os._exit(status)


def stop(_: object) -> None:
    sys.exit("enough")


def kill(_: object) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def hang(_: object) -> None:
    time.sleep(3600)


def secret(_: object) -> object:
    return object()


def complain(_: object) -> None:
    raise DatasetError("frames.csv, line 3: gone")


def scream(_: object) -> None:
    raise ValueError("x" * 10_000_000)


def babble(_: object) -> None:
    for descriptor in range(3, 64):
        try:
            os.write(descriptor, b"[1, 2]\n")
        except OSError:
            continue


@pytest.fixture
def host(monkeypatch: pytest.MonkeyPatch) -> Iterator[PluginHost]:
    monkeypatch.setenv(LIMIT_VARIABLE, "600")
    host = PluginHost(())
    yield host
    host.end()


def test_it_answers_from_another_process_in_a_folder_of_its_own(host: PluginHost) -> None:
    pid, folder = host.ask(where, ())
    assert pid != os.getpid()
    assert folder != os.getcwd()
    assert host.ask(double, ([1.5, float("inf")],)) == [1.5, float("inf")] * 2
    assert host.ask(where, ()) == [pid, folder]
    host.end()
    assert not psutil.pid_exists(pid)
    assert not os.path.exists(folder)


def test_a_host_whose_program_was_killed_removes_its_folder_and_ends(tmp_path: Path) -> None:
    program = (
        "import json, time; from codecbench.core.engine.hosting.host import PluginHost; host = PluginHost(()); "
        "print(json.dumps(host.ask('test_host:where', ())), flush=True); time.sleep(3600)"
    )
    paths = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    environment = {**os.environ, "TMPDIR": str(tmp_path), "PYTHONPATH": paths}
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, env=environment) as asker:
        assert asker.stdout is not None
        pid, folder = json.loads(asker.stdout.readline())
        assert list(tmp_path.iterdir()) == [Path(folder)]
        asker.kill()
    deadline = time.monotonic() + 300
    while (psutil.pid_exists(pid) or list(tmp_path.iterdir())) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not psutil.pid_exists(pid)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("function", "arguments", "kind", "words"),
    [
        (leave, (0,), PluginLoss, "it ended its process with status 0"),
        (kill, (), PluginLoss, "it ended its process by SIGKILL"),
        (stop, (), PluginFault, "SystemExit: enough"),
        (secret, (), PluginFault, "TypeError: Object of type object is not JSON serializable"),
        (complain, (), DatasetError, "frames.csv, line 3: gone"),
        (babble, (), PluginFault, "it answered nonsense"),
    ],
    ids=lambda value: getattr(value, "__name__", None),
)
def test_what_goes_wrong_is_an_error_and_the_next_question_is_answered(
    host: PluginHost, function: Any, arguments: tuple[Any, ...], kind: type[Exception], words: str
) -> None:
    with pytest.raises(kind, match=words):
        host.ask(function, arguments)
    assert host.ask(double, (4,)) == 8


def test_a_host_that_hangs_is_ended_in_time(host: PluginHost, monkeypatch: pytest.MonkeyPatch) -> None:
    pid, _ = host.ask(where, ())
    monkeypatch.setenv(LIMIT_VARIABLE, "0.5")
    with pytest.raises(PluginTimeout, match=r"no answer within 0\.5 s"):
        host.ask(hang, ())
    assert not psutil.pid_exists(pid)


def test_a_reason_is_of_bounded_length(host: PluginHost) -> None:
    with pytest.raises(PluginFault, match="ValueError: xxx") as caught:
        host.ask(scream, ())
    assert len(str(caught.value)) <= 4000
