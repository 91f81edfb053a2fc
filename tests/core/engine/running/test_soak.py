"""Many short runs, in one process and in many, some of them killed: nothing may grow with their number.

The short form takes half a minute, the long one as many minutes as SOAK_MINUTES says, 30 if it says nothing.
Both log what was done and held:
pytest tests/core/engine/running/test_soak.py --slow -n 0 -o log_cli=true -o log_cli_level=INFO
"""

from __future__ import annotations

import ctypes
import gc
import logging
import math
import os
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path

import psutil
import pytest
from distributions import install_source, register
from installed_command import COMMAND, Place
from project import SUPPORT, THIRD_PARTY

from codecbench.core.engine.planning.matrix import read_matrix
from codecbench.core.engine.planning.plan import make_plan
from codecbench.core.engine.plugins.registry import installed
from codecbench.core.engine.running.run import run_plan

pytestmark = pytest.mark.slow

log = logging.getLogger("soak")

MATRIX = """
version: 1
name: {name}
sequences: [{{use: ramp, params: {{frames: 3}}}}]
codecs: [{codecs}]
evaluators: [error]
run: {{workers: 2, executor: {executor}}}
"""
STUCK = '''
import os, signal, time
from pathlib import Path
from codecbench import NULL_TRACE, NoParams, PluginSpec, hookimpl
from codecbench.plugins.codecs import jpeg2000

class Stuck(jpeg2000.Jpeg2000):
    """Hangs, or dies, in the middle of JPEG 2000, when OpenJPEG has been given a file to write."""

    name = "stuck"
    version = "1"

    def encode(self, image, *, trace=NULL_TRACE):
        with jpeg2000._scratch_file() as path:
            path.write_bytes(bytes(1000))
            if self.params.lossless:
                os.kill(os.getpid(), signal.SIGKILL)
            time.sleep(60)

@hookimpl
def codecbench_codecs():
    return [PluginSpec("stuck", "stuck:Stuck", "hangs")]
'''
SHORT_RUNS = 40
"""Runs inside this process for each one with workers, each command and each command that is killed."""
WARM_ROUNDS = 1
"""Until then libraries load what they load once."""


@dataclass(frozen=True)
class Held:
    """What this process and those before it hold on to."""

    memory_mb: float
    descriptors: int
    threads: int
    children: int
    temporary: int
    shared_memory: int

    @classmethod
    def now(cls, folder: Path, shared_before: set[str]) -> Held:
        gc.collect()
        ctypes.CDLL(None).malloc_trim(0)
        process = psutil.Process()
        return cls(
            process.memory_info().rss / 2**20,
            process.num_fds(),
            threading.active_count(),
            len(process.children(recursive=True)),
            len(list(folder.iterdir())),
            len(shared_memory_of_none_else() - shared_before),
        )

    def exceeds(self, other: Held, memory_mb: float) -> list[str]:
        """What is more than in `other`; of memory what is more by `memory_mb`."""
        before = {**asdict(other), "memory_mb": other.memory_mb + memory_mb}
        return [f"{name}: {value}, was {before[name]}" for name, value in asdict(self).items() if value > before[name]]


def shared_memory_of_none_else() -> set[str]:
    """What is in /dev/shm but for what processes other than this one have mapped, such as other runs' semaphores."""
    elsewhere = ""
    for process in psutil.process_iter():
        if process.pid != os.getpid():
            with suppress(OSError):
                elsewhere += Path(f"/proc/{process.pid}/maps").read_text(errors="replace")
    return {name for name in os.listdir("/dev/shm") if f"/dev/shm/{name}" not in elsewhere}


@dataclass
class Soak:
    """Short runs in a folder, their temporary files in another."""

    place: Place
    temporary: Path
    counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(("inline", "workers", "command", "killed"), 0))
    shared_before: set[str] = field(default_factory=shared_memory_of_none_else)

    def held(self) -> Held:
        return Held.now(self.temporary, self.shared_before)

    def round(self) -> None:
        for _ in range(SHORT_RUNS):
            self._here("inline")
        self._here("workers")
        self._command()
        self._killed()

    def swept(self, than: Held | None = None) -> Held:
        """What is held after another run, which sweeps up what a command left that was killed; and a moment later
        where it is more than it was, for what was killed takes a while to be gone."""
        self._here("workers")
        time.sleep(1)
        deadline = time.monotonic() + 20
        while than is not None and self.held().exceeds(than, math.inf) and time.monotonic() < deadline:
            time.sleep(0.5)
        return self.held()

    def _out(self, name: str) -> Path:
        self.counts[name] += 1
        return self.place.folder / "out" / f"{name}-{self.counts[name]}"

    def _here(self, name: str) -> None:
        folder = self._out(name)
        plan = make_plan(read_matrix(self.place.folder / f"{name}.yaml"))
        statuses = run_plan(plan, folder, log_level=logging.ERROR).statuses
        assert statuses == ({"ok": 2} if name == "inline" else {"ok": 2, "crashed": 1}), statuses
        shutil.rmtree(folder)

    def _command(self) -> None:
        folder = self._out("command")
        done = self.place.call("run", "inline.yaml", "--out", str(folder), TMPDIR=str(self.temporary))
        assert done.status == 0, done.output
        shutil.rmtree(folder)

    def _killed(self) -> None:
        """A command that is killed while its worker is in the middle of JPEG 2000."""
        folder = self._out("killed")
        running = self.place.start("run", "stuck.yaml", "--out", str(folder), TMPDIR=str(self.temporary))
        deadline = time.monotonic() + 60
        while not list(self.temporary.rglob("frame.jp2")):
            assert time.monotonic() < deadline, "no worker got to its codec"
            time.sleep(0.02)
        running.send_signal(signal.SIGKILL)
        running.communicate()
        shutil.rmtree(folder)


@pytest.fixture
def soak(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Soak]:
    assert COMMAND.exists()
    place, temporary = Place(tmp_path / "place"), tmp_path / "temporary"
    place.folder.mkdir()
    temporary.mkdir()
    shutil.copy(SUPPORT / "plain_plugins.py", place.site)
    register(place.site, "plain", "1", "plain_plugins")
    shutil.copytree(THIRD_PARTY / "inline" / "codecbench_inline", place.site / "codecbench_inline")
    register(place.site, "codecbench-inline", "1", "codecbench_inline")
    install_source(place.site, "stuck", "1", STUCK)
    few, stuck = "shift, {use: shift, params: {bits: 3}}", "{use: stuck, params: {ratio: 8}}"
    dying = "{use: stuck, params: {lossless: true}}"
    matrices = {"inline": (few, "inline"), "workers": (f"{few}, {dying}", "local"), "stuck": (stuck, "local")}
    for name, (codecs, executor) in matrices.items():
        (place.folder / f"{name}.yaml").write_text(MATRIX.format(name=name, codecs=codecs, executor=executor))
    monkeypatch.syspath_prepend(str(place.site))
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    monkeypatch.setenv("TMPDIR", str(temporary))
    installed.cache_clear()
    yield Soak(place, temporary)
    installed.cache_clear()
    for name in ("plain_plugins", "codecbench_inline", "stuck"):
        sys.modules.pop(name, None)


def soaked(soak: Soak, minutes: float, memory_mb: float) -> None:
    """Make rounds for so long; nothing may be more at the end than when each had been done once."""
    for _ in range(WARM_ROUNDS):
        soak.round()
    first, begun, before = soak.swept(), time.monotonic(), dict(soak.counts)
    log.info("at first: %s", first)
    said = begun
    while time.monotonic() < begun + 60 * minutes:
        soak.round()
        if time.monotonic() - said > 60:
            said = time.monotonic()
            log.info("after %.0f s, %s: %s", said - begun, soak.counts, soak.held())
    last, done = soak.swept(first), {name: count - before[name] for name, count in soak.counts.items()}
    log.info("after %.0f s, %s: %s", time.monotonic() - begun, done, last)
    excess = last.exceeds(first, memory_mb)
    grown = last.memory_mb - first.memory_mb
    log.info("%d runs; memory %+.1f MB, %+.2f kB a run", sum(done.values()), grown, grown * 1024 / sum(done.values()))
    assert not excess, f"{excess} after {done}"


def test_nothing_grows_in_half_a_minute_of_short_runs(soak: Soak) -> None:
    soaked(soak, 0.5, memory_mb=16)


@pytest.mark.timeout(25 * 3600)
def test_nothing_grows_in_many_minutes_of_short_runs(soak: Soak) -> None:
    soaked(soak, float(os.environ.get("SOAK_MINUTES", "30")), memory_mb=32)
