"""A run folder is run in, killed in, edited, damaged and used twice at once, in any order, beside a model of it.

The model says which records must be there and whole; what each must say is known from a run that nothing happened to.
"""

from __future__ import annotations

import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, Final

import cv2
import pytest
from distributions import register
from engine_bench import Bench, contents
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule, run_state_machine_as_test
from project import THIRD_PARTY

from codecbench.core.analysis.collect import open_run
from codecbench.core.conformance.material import integer_image
from codecbench.core.contracts.errors import StoreError
from codecbench.core.engine.planning.model import Plan
from codecbench.core.engine.plugins.registry import installed
from codecbench.core.engine.running.progress import Progress
from codecbench.core.engine.storage.store import Store

pytestmark = pytest.mark.thorough

MATRIX: Final = """
version: 1
sequences: [{{use: folder, params: {{path: frames}}}}]
codecs: [{{use: jpeg, params: {{quality: {{grid: {qualities}}}}}}}]
evaluators: {evaluators}
run: {{workers: 1, executor: inline}}
"""
"""Of codecbench's own plugins, which need no process beside this one."""
QUALITIES: Final = [20, 40, 60, 80]
EVALUATORS: Final = ["features", "quality"]
DAMAGES: Final[dict[str, Callable[[bytes, int], bytes]]] = {
    "flip": lambda content, at: content[:at] + bytes([content[at] ^ 1 << at % 8]) + content[at + 1 :],
    "cut": lambda content, at: content[:at],
    "zeros": lambda content, at: content[:at] + bytes(len(content) - at),
    "longer": lambda content, at: content + content[at:],
}
OPERATIONS: Final = ("os.rename", "os.mkdir", "os.remove", "os.rmdir", "open")
_left = [0]
"""How many more operations a process that is to be killed may begin; 0 in all others."""


def _die_when_told(event: str, _: Any) -> None:
    if _left[0] and event in OPERATIONS:
        _left[0] -= 1
        if not _left[0]:
            os.kill(os.getpid(), signal.SIGKILL)


sys.addaudithook(_die_when_told)


class RunFolder(RuleBasedStateMachine):
    """What is done to a folder, and `kept`: the cells whose records it must have."""

    bench: ClassVar[Bench]
    whole: ClassVar[Plan]
    expected: ClassVar[dict[str, str]]
    summaries: ClassVar[dict[str, str]]

    def __init__(self) -> None:
        super().__init__()
        self.name = Path(tempfile.mkdtemp(prefix="model-", dir=self.bench.folder)).name + "/run"
        self.kept: set[str] = set()
        self.plan = self.planned({20, 40}, {"quality"})

    def teardown(self) -> None:
        shutil.rmtree(self.store.folder.parent)

    @property
    def store(self) -> Store:
        return self.bench.store(self.name)

    @property
    def files(self) -> list[Path]:
        return sorted(path for path in self.store.folder.rglob("*") if path.is_file())

    def planned(self, qualities: set[int], evaluators: set[str]) -> Plan:
        return self.bench.plan(MATRIX.format(qualities=sorted(qualities), evaluators=sorted(evaluators)))

    @rule(
        qualities=st.sets(st.sampled_from(QUALITIES), min_size=1),
        evaluators=st.sets(st.sampled_from(EVALUATORS), min_size=1),
    )
    def edit(self, qualities: set[int], evaluators: set[str]) -> None:
        self.plan = self.planned(qualities, evaluators)

    @rule(recompute=st.sampled_from([(), (), ("jpeg",)]))
    def run(self, recompute: tuple[str, ...]) -> None:
        wanted = {cell.id for cell in self.plan.cells}
        summary = self.bench.run(self.plan, self.name, workers=1, recompute=recompute)
        assert summary.statuses == {"ok": len(wanted)}
        assert summary.kept >= (0 if recompute else len(self.kept & wanted))
        assert summary.kept + summary.computed == len(wanted)
        assert found(self.store, self.plan) == {id_: self.expected[id_] for id_ in wanted}
        self.kept |= wanted
        assert [cell.status for cell in open_run(self.store.folder).results] == ["ok"] * len(wanted)
        assert not list(self.store.folder.rglob(".*"))

    @rule(operation=st.integers(1, 60))
    def be_killed(self, operation: int) -> None:
        """A run whose process is killed when it begins its operation of that number, if it comes so far."""
        heard, told = os.pipe()
        child = os.fork()
        if not child:
            _left[0] = operation
            with suppress(BaseException):
                self.bench.run(self.plan, self.name, workers=1, listener=lambda progress: tell(told, progress))
            os._exit(0)
        os.close(told)
        with os.fdopen(heard) as stream:
            self.kept |= set(stream.read().split())
        os.waitpid(child, 0)

    @rule(which=st.integers(0), how=st.sampled_from(sorted(DAMAGES)), where=st.integers(0))
    def damage(self, which: int, how: str, where: int) -> None:
        if files := [path for path in self.files if path.stat().st_size]:
            path = files[which % len(files)]
            content = path.read_bytes()
            path.write_bytes(DAMAGES[how](content, where % len(content)))
            self.lose(path)

    @rule(which=st.integers(0))
    def delete(self, which: int) -> None:
        if files := self.files:
            files[which % len(files)].unlink()
            self.lose(files[which % len(files)])

    @rule(first=st.integers(0), second=st.integers(0))
    def swap(self, first: int, second: int) -> None:
        """Files of one kind change places."""
        if files := self.files:
            path = files[first % len(files)]
            alike = [other for other in files if other.suffix == path.suffix]
            other = alike[second % len(alike)]
            between = path.with_name("between")
            for source, target in ((path, between), (other, path), (between, other)):
                if source.exists():
                    source.rename(target)
            self.lose(path)
            self.lose(other)

    @rule()
    def use_twice(self) -> None:
        with self.store.locked(), pytest.raises(StoreError, match="is in use by"):
            self.bench.run(self.plan, self.name, workers=1)

    def lose(self, path: Path) -> None:
        self.kept -= {path.parent.name}

    @invariant()
    def what_must_be_there_is_there_and_what_is_taken_for_sound_is_right(self) -> None:
        sound, _ = self.store.sound_entries(self.expected)
        assert self.kept <= {id_ for id_, entry in sound.items() if entry.status == "ok"}
        known = replace(self.whole, cells=tuple(cell for cell in self.whole.cells if cell.id in sound))
        assert found(self.store, known) == {id_: self.expected[id_] for id_ in sound}

    @invariant()
    def tables_are_right_or_refused(self) -> None:
        with suppress(StoreError):
            for result in open_run(self.store.folder).results:
                assert result.status != "ok" or repr(result.summaries) == self.summaries[result.cell.id]


def found(store: Store, plan: Plan) -> dict[str, str]:
    """What the records of a plan say, as texts, in which values that are missing are alike."""
    return {id_: repr(content) for id_, content in contents(store, plan).items()}


def tell(pipe: int, progress: Progress) -> None:
    if progress.cell is not None and progress.record is not None and progress.record.status == "ok":
        os.write(pipe, f"{progress.cell.id}\n".encode())


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[type[RunFolder]]:
    """The machine, with a bench, and what a run of all settings finds that nothing happens to."""
    bench = Bench(tmp_path, tmp_path / "site")
    shutil.copytree(THIRD_PARTY / "inline" / "codecbench_inline", bench.site / "codecbench_inline")
    register(bench.site, "codecbench-inline", "1", "codecbench_inline")
    (tmp_path / "frames").mkdir()
    for number in range(2):
        cv2.imwrite(str(tmp_path / "frames" / f"{number}.png"), integer_image(number, 24, 32, 1))
    monkeypatch.syspath_prepend(str(bench.site))
    installed.cache_clear()
    whole = bench.plan(MATRIX.format(qualities=QUALITIES, evaluators=EVALUATORS))
    bench.run(whole, "whole", workers=1)
    summaries = {result.cell.id: repr(result.summaries) for result in open_run(tmp_path / "whole").results}
    known = {"bench": bench, "whole": whole, "expected": found(bench.store("whole"), whole), "summaries": summaries}
    yield type("RunFolderHere", (RunFolder,), known)
    installed.cache_clear()
    sys.modules.pop("codecbench_inline", None)


def drive(machine: type[RunFolder], examples: int, steps: int) -> None:
    """Try so many sequences of so many steps, the same ones every time."""
    run_state_machine_as_test(
        machine,
        settings=settings(
            max_examples=examples,
            stateful_step_count=steps,
            derandomize=True,
            database=None,
            deadline=None,
            suppress_health_check=list(HealthCheck),
        ),
    )


def test_whatever_is_done_to_a_run_folder_it_has_what_it_must_and_mends(machine: type[RunFolder]) -> None:
    drive(machine, examples=6, steps=12)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_whatever_is_done_for_long_to_a_run_folder_it_has_what_it_must_and_mends(machine: type[RunFolder]) -> None:
    drive(machine, examples=300, steps=30)
