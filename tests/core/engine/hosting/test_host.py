"""A host answers with data, and whatever goes wrong in it costs the question that was asked."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.engine.hosting.channel import Exposed
from codecbench.core.engine.hosting.host import LIMIT_VARIABLE, Host, PluginFault, PluginLoss, PluginTimeout


def where() -> list[Any]:
    return [os.getpid(), os.getcwd()]


def double(value: Any) -> Any:
    return 2 * value


def leave(status: int) -> None:
    os._exit(status)


def stop() -> None:
    sys.exit("enough")


def kill() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def hang() -> None:
    signal.pause()


def talk(asked: Any) -> None:
    while True:
        asked()


def complain() -> None:
    raise DatasetError("frames.csv, line 3: gone")


def scream() -> None:
    raise ValueError("x" * 10_000_000)


def run_out() -> None:
    raise StopIteration


def babble() -> None:
    for descriptor in range(3, 64):
        try:
            os.write(descriptor, b"[1, 2]\n")
        except OSError:
            continue


def close_all() -> None:
    os.closerange(3, 64)


def fork() -> int:
    """The call comes back twice."""
    os.fork()
    return 5


def tower() -> Any:
    found: list[Any] = []
    for _ in range(100):
        found = [found]
    return found


def call(function: Callable[..., Any], *arguments: Any) -> Any:
    return function(*arguments)


def total(numbers: Iterator[int]) -> int:
    return sum(numbers)


def swallow(function: Callable[..., Any]) -> str:
    try:
        function()
    except DatasetError as error:
        return str(error)
    return ""


@pytest.fixture(autouse=True)
def _patient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(LIMIT_VARIABLE, "600")


@pytest.fixture(scope="module")
def host() -> Iterator[Host]:
    """One for all tests, because each that is started costs a second; those that end it start another."""
    host = Host("mine 1")
    yield host
    host.end()


def test_it_answers_from_another_process_in_a_folder_of_its_own(host: Host) -> None:
    pid, folder = host.ask(where)
    assert pid != os.getpid()
    assert folder != os.getcwd()
    assert host.ask(double, [1.5, float("inf")]) == [1.5, float("inf")] * 2
    assert host.ask(where) == [pid, folder]
    assert host.lives
    host.end()
    assert not host.lives
    assert not psutil.pid_exists(pid)
    assert not os.path.exists(folder)


def test_large_arrays_go_both_ways(host: Host) -> None:
    for size in (10, 3_000_000, 5):
        numbers = np.arange(size, dtype=np.uint16)
        np.testing.assert_array_equal(host.ask(double, numbers), numbers * 2)


def test_it_asks_for_what_it_was_given(host: Host) -> None:
    assert host.ask(call, Exposed("function", lambda *numbers: sum(numbers)), 3, 4) == 7
    assert host.ask(total, Exposed("iterator", iter([1, 2, 3]))) == 6
    nested = Exposed("function", lambda: host._channel and host._channel.call(None, f"{__name__}:double", 4))
    assert host.ask(call, nested) == 8


@pytest.mark.parametrize("error", [DatasetError("line 3: gone"), KeyError("x"), OSError(28, "full")], ids=repr)
def test_an_error_of_ours_that_passes_through_it_is_the_same_object(host: Host, error: Exception) -> None:
    def fail() -> None:
        raise error

    with pytest.raises(type(error)) as caught:
        host.ask(call, Exposed("function", fail))
    assert caught.value is error
    assert host.ask(double, 4) == 8


def test_an_error_of_ours_is_of_its_kind_in_the_host(host: Host) -> None:
    def fail() -> None:
        raise DatasetError("line 3: gone")

    assert host.ask(swallow, Exposed("function", fail)) == "line 3: gone"


def test_a_host_whose_program_was_killed_removes_its_folder_and_ends(tmp_path: Path) -> None:
    program = (
        "import json, time; from codecbench.core.engine.hosting.host import Host; host = Host('mine 1'); "
        "print(json.dumps(host.ask('test_host:where')), flush=True); time.sleep(3600)"
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
        (leave, (0,), PluginLoss, "exited with status 0"),
        (kill, (), PluginLoss, "killed by SIGKILL"),
        (stop, (), PluginFault, "SystemExit: enough"),
        (run_out, (), PluginFault, "StopIteration"),
        (complain, (), DatasetError, r"\.csv, line 3: gone"),
        (babble, (), PluginFault, "invalid answer"),
        (close_all, (), PluginLoss, "exited with status 1"),
        (tower, (), PluginFault, "invalid answer"),
        ("codecbench.nothing:here", (), PluginFault, "ModuleNotFoundError"),
    ],
    ids=lambda value: getattr(value, "__name__", None),
)
def test_what_goes_wrong_is_an_error_and_the_next_question_is_answered(
    host: Host, function: Any, arguments: tuple[Any, ...], kind: type[Exception], words: str
) -> None:
    with pytest.raises(kind, match=words):
        host.ask(function, *arguments)
    assert host.ask(double, 4) == 8


def test_what_comes_back_twice_answers_once(host: Host) -> None:
    assert host.ask(fork) == 5
    assert host.ask(double, 4) == 8


@pytest.mark.parametrize("function", [hang, talk])
def test_a_host_that_does_not_answer_is_ended_in_time(
    host: Host, monkeypatch: pytest.MonkeyPatch, function: Callable[..., Any]
) -> None:
    pid, _ = host.ask(where)
    monkeypatch.setenv(LIMIT_VARIABLE, "0.2")
    with pytest.raises(PluginTimeout, match=r"no answer within 0\.2 s"):
        host.ask(function, *([Exposed("function", int)] if function is talk else []))
    assert not psutil.pid_exists(pid)


def test_a_reason_is_of_bounded_length(host: Host) -> None:
    with pytest.raises(PluginFault, match="ValueError: xxx") as caught:
        host.ask(scream)
    assert len(str(caught.value)) <= 4000


@pytest.mark.parametrize("prints", [False, True])
def test_what_its_plugins_print_goes_where_it_is_said(prints: bool, capfd: pytest.CaptureFixture[str]) -> None:
    host = Host("mine 1", "decode", prints=prints)
    host.ask("builtins:print", "hello")
    host.ask("os:write", 2, b"there\n")
    host.ask("builtins:exec", "import sys; sys.stdout.flush()")
    host.end()
    assert capfd.readouterr() == (("hello\n", "there\n") if prints else ("", ""))


class Session:
    """As a codec opens them."""

    living = 0

    def __init__(self) -> None:
        Session.living += 1

    def __del__(self) -> None:
        Session.living -= 1

    def flush(self) -> int:
        return Session.living


def session() -> Exposed:
    return Exposed("decoder", Session())


def test_objects_that_nobody_knows_any_more_are_forgotten(host: Host) -> None:
    kept = host.ask(session)
    for _ in range(10):
        host.ask(session)
    assert kept.flush() == 1
