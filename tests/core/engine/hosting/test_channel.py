"""What the other end of a conversation says is understood or refused, whatever it is, and never obeyed."""

from __future__ import annotations

import fcntl
import json
import os
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.engine.hosting.channel import Channel, Exposed, PluginFault, PluginNonsense, SharedMemory

UNLOADED = "codecbench.core.analysis.bjontegaard"


@dataclass
class Stranger:
    """The other end, by hand. says: its lines to come."""

    channel: Channel
    reads: int
    writes: int
    memory: SharedMemory
    heard: list[Any] = field(default_factory=list)

    def says(self, message: Any, size: int = 0) -> None:
        self.writes_line(json.dumps([size, {"dict": [[name, part] for name, part in message.items()]}]).encode())

    def writes_line(self, line: bytes) -> None:
        os.write(self.writes, line + b"\n")

    def asked(self, *arguments: Any) -> Any:
        return self.channel.call(None, "somewhere:something", *arguments)

    def hears(self) -> list[dict[str, Any]]:
        """What was said to it, as JSON types with their names."""
        os.set_blocking(self.reads, False)
        return [dict(json.loads(line)[1]["dict"]) for line in os.read(self.reads, 1 << 20).splitlines()]


@pytest.fixture
def stranger() -> Iterator[Stranger]:
    taken, writes = os.pipe()
    reads, given = os.pipe()
    ours, theirs = SharedMemory(), SharedMemory()
    yield Stranger(Channel(reads, writes, ours, theirs, lambda *_: None), taken, given, theirs)
    for descriptor in (taken, writes, reads, given):
        os.close(descriptor)
    ours.close()
    theirs.close()


def record(name: str, **values: Any) -> dict[str, Any]:
    return {"record": name, "fields": {name: {"list": value} for name, value in values.items()}}


HOSTILE = [
    record("subprocess:Popen", args=["touch", "called"]),
    record("codecbench.core.engine.hosting.host:subprocess.Popen", args=["touch", "called"]),
    record("codecbench.core.engine.hosting.host:Host", distribution=[]),
    record("codecbench.core.contracts.stream:Packet", surprise=[]),
    record("codecbench.core.contracts.features:Features", size=[], pixels=[], octaves=[], angles=[], responses=[]),
    record(f"{UNLOADED}:Suspicion"),
    record("codecbench"),
    {"enum": "codecbench.core.contracts.stream:Loss", "name": "nobody"},
    {"enum": "os:PathLike", "name": "x"},
    {"bytes": [0, 1 << 40]},
    {"bytes": [-1, 1]},
    {"bytes": [0, float("inf")]},
    {"array": [0, 0], "dtype": "O", "shape": [0]},
    {"array": [0, 0], "dtype": "(", "shape": [0]},
    {"array": [0, 4], "dtype": "u1", "shape": [float("inf")]},
    {"array": [0, 4], "dtype": "u1", "shape": [1 << 70]},
    {"rng": {"dict": [["seed", {"dict": []}], ["state", {"dict": []}]]}},
    {"object": 5, "owner": "receiver"},
    {"object": -1, "owner": "receiver"},
    {"object": 0, "kind": "nothing"},
    {"object": {"list": []}, "kind": "function"},
    {"list": 5},
    {"set": [{"list": []}]},
    {"other": "a\0b"},
    {"surprise": 1},
    [1],
]


@pytest.mark.parametrize("value", HOSTILE, ids=lambda value: json.dumps(value)[:60])
def test_an_invalid_value_is_an_invalid_answer(stranger: Stranger, value: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, UNLOADED, raising=False)
    stranger.memory.write([bytes(4)])
    stranger.says({"number": 1, "value": value}, 4)
    with pytest.raises(PluginNonsense, match="invalid answer"):
        stranger.asked()
    assert UNLOADED not in sys.modules


@pytest.mark.parametrize(
    "line",
    [
        b"", b"nonsense", b"[1, 2]", b"[0]", b"{}", b"\xff", b"[" * 100_000,
        b"[0, " + b'{"list": [' * 50 + b"]}" * 50 + b"]",
        b'[0, {"dict": [["number", 2], ["value", 1]]}]', b'[0, {"dict": [["value", 1]]}]', b'[0, {"dict": [[[], 1]]}]',
        b'[1e999, {"dict": [["number", 1], ["value", 1]]}]', b'[-1, {"dict": [["number", 1], ["value", 1]]}]',
        b'[1, {"dict": [["number", 1], ["value", 1]]}]', b'[1180591620717411303424, {"dict": [["number", 1]]}]',
    ],
    ids=lambda line: line[:40].decode(errors="replace"),
)  # fmt: skip
def test_an_invalid_line_is_an_invalid_answer(stranger: Stranger, line: bytes) -> None:
    if len(line) > 1 << 15:
        fcntl.fcntl(stranger.writes, fcntl.F_SETPIPE_SZ, 1 << 18)
    stranger.writes_line(line)
    with pytest.raises(PluginNonsense, match="invalid answer"):
        stranger.asked()


@pytest.mark.parametrize("name", ["json", "Any", "__name__", "__doc__", "StopIteration", "PluginError", 7])
def test_an_error_of_any_name_is_a_fault(stranger: Stranger, name: Any) -> None:
    stranger.says({"number": 1, "error": name, "text": "no", "returned": 3, "raised": "x"})
    with pytest.raises(PluginFault, match=r"\Ano\Z"):
        stranger.asked()


def test_an_error_of_codecbench_keeps_its_kind(stranger: Stranger) -> None:
    stranger.says({"number": 1, "error": "DatasetError", "text": "line 3: gone"})
    with pytest.raises(DatasetError, match="line 3: gone"):
        stranger.asked()


def test_who_is_asked_may_call_nothing_that_it_was_not_given(stranger: Stranger, tmp_path: Path) -> None:
    given: Any = {"object": 0, "owner": "receiver"}
    stranger.says({"number": 7, "call": "os:mkdir", "with": {"list": [str(tmp_path / "made")]}})
    stranger.says({"number": 8, "call": "__reduce_ex__", "on": given, "with": {"list": [4]}})
    stranger.says({"number": 9, "call": "__call__", "on": None})
    stranger.says({"number": 10, "call": "__call__", "on": given, "with": {"list": [5]}})
    stranger.says({"number": 11, "call": "__call__", "on": given, "with": 5, "words": 5})
    stranger.says({"number": 1, "value": "done"})
    assert stranger.asked(Exposed("function", lambda value: 2 * value)) == "done"
    _, *answers = stranger.hears()
    assert [answer.get("value") for answer in answers] == [None, None, None, 10, None]
    outside, hidden, nobody, _, wrong = [str(answer.get("text")) for answer in answers]
    assert re.search(r"^WireError: .*os:mkdir", outside)
    assert re.search(r"^WireError: __reduce_ex__ ", hidden)
    assert re.search(r"^WireError: __call__ ", nobody)
    assert re.search(r"^TypeError: 'int' .*not iterable", wrong)
    assert list(tmp_path.iterdir()) == []


def test_calls_that_wait_for_each_other_are_counted(stranger: Stranger) -> None:
    asked = Exposed("function", lambda: stranger.asked())
    for number in range(22):
        stranger.says({"number": 100 + number, "call": "__call__", "on": {"object": 0, "owner": "receiver"}})
    for number in range(21, 0, -1):
        stranger.says({"number": number, "value": number})
    assert stranger.asked(asked) == 1
    answers = [heard for heard in stranger.hears() if "call" not in heard]
    told = [(answer["number"], answer.get("value", answer.get("text"))) for answer in answers]
    too_many = "RecursionError: more than 20 nested calls"
    assert told == [(120, too_many), (121, too_many), *((119 - n, 21 - n) for n in range(20))]


def test_an_error_returns_to_the_conversation_that_it_came_from_alone() -> None:
    """An error of one asker, told to another one, is not taken for what that one has raised under the same number."""
    first, other = (Channel(-1, -1, SharedMemory(), SharedMemory(), lambda *_: None, obeys=True) for _ in range(2))
    error = first._error({"error": "DatasetError", "text": "of the first", "raised": 0}, "read")
    assert isinstance(error, DatasetError)
    assert first._error_message(error)["returned"] == 0
    assert other._error_message(error)["returned"] is None


def test_memory_that_both_see_grows_and_never_shrinks() -> None:
    memory = SharedMemory()
    assert memory.write([b"abc", b"de"]) == 5
    assert bytes(memory.view(5)) == b"abcde"
    assert memory.write([bytes(100_000), b"x"]) == 100_001
    assert bytes(memory.view(100_001)[-2:]) == b"\0x"
    with pytest.raises(PermissionError):
        os.ftruncate(memory.descriptor, 0)
    with pytest.raises(PermissionError):
        fcntl.fcntl(memory.descriptor, fcntl.F_ADD_SEALS, fcntl.F_SEAL_GROW)
    memory.close()
    memory.close()
