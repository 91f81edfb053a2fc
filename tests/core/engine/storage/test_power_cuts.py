"""The power is cut before every operation of a run and after the last.

The folder opens, nothing that was reported is lost, and the next run mends it. What nobody waited for may be missing,
cut short or zeros; names of a folder that was not waited for may be as before.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from disk_model import Disk, State, put
from engine_bench import HERE, Bench, bench_without_processes, contents, matrix

from codecbench.core.contracts.errors import StoreError
from codecbench.core.engine.identity import content_digest
from codecbench.core.engine.planning.model import Plan
from codecbench.core.engine.running.progress import Progress
from codecbench.core.engine.storage import atomic, store
from codecbench.core.engine.storage.store import Store


def test_the_disk_has_what_was_waited_for_and_may_lack_the_rest(tmp_path: Path) -> None:
    (root := tmp_path / "root").mkdir()
    disk = Disk(root)
    with disk.following(atomic):
        atomic.write_file(root / "quick", b"abcd")
        atomic.write_file(root / "far" / "waited", b"efgh", durable=True)
        with open(root / "far" / "waited", "ab", buffering=0) as stream:
            stream.write(b"ijkl")
        os.rename(root / "far" / "waited", root / "far" / "moved")
        atomic.sync_file_system(root)
    operations = [what.split()[0].removeprefix("os.") for what, _ in disk.moments]
    assert operations == ["mkdir", "rename", "mkdir", "fsync", "fsync", "rename", "fsync", "rename", "syncfs", "the"]
    _, _, quick, *_, waited, moved, everything = [states for _, states in disk.moments]
    assert quick["new names, kept"] == {"quick": b"abcd"}
    assert quick["new names, half"] == {"quick": b"ab"}
    assert quick["new names, zeros"] == {"quick": bytes(4)}
    assert quick["old names, kept"] == {}
    assert waited["new names, nothing"] == {"quick": b"", "far": None, "far/waited": b"efgh"}
    assert waited["old names, zeros"] == {"quick": bytes(4), "far": None, "far/waited": b"efgh" + bytes(4)}
    assert moved["new names, zeros"] == {"quick": bytes(4), "far": None, "far/moved": b"efgh" + bytes(4)}
    assert moved["old names, kept"]["far/waited"] == b"efghijkl"
    assert all(state == {"quick": b"abcd", "far": None, "far/moved": b"efghijkl"} for state in everything.values())
    put(moved["new names, half"], tmp_path / "after")
    assert (tmp_path / "after" / "far" / "moved").read_bytes() == b"efghij"


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with bench_without_processes(tmp_path) as made:
        yield made


@pytest.fixture
def plan(bench: Bench) -> Plan:
    """A cell with samples and another with an artifact, computed in this process."""
    return bench.plan(matrix("faulty", "wandering, whole", HERE))


class Hasty:
    """Stands for `os` where nothing need be waited for."""

    def fsync(self, _: int) -> None:
        pass

    def syncfs(self, _: int) -> int:
        return 0

    def __getattr__(self, name: str) -> Any:
        return getattr(os, name)


@dataclass
class Cuts:
    """A run whose disk is followed. finished: cells that were reported `ok`, and after how many operations."""

    bench: Bench
    plan: Plan
    expected: dict[str, Any]
    finished: list[tuple[int, str]] = field(default_factory=list)
    disk: Disk = field(init=False)

    def run(self, **options: Any) -> None:
        (root := self.bench.folder / "disk").mkdir(exist_ok=True)
        self.disk = Disk(root)

        def listen(progress: Progress) -> None:
            if progress.cell is not None and progress.record is not None and progress.record.status == "ok":
                self.finished.append((len(self.disk.moments), progress.cell.id))

        with self.disk.following(atomic):
            self.bench.run(self.plan, "disk/run", workers=1, listener=listen, **options)

    def check(self) -> int:
        """Cut the power before each operation and at the end; returns how many different states were looked at."""
        seen: set[str] = set()
        for number, (what, states) in enumerate(self.disk.moments):
            finished = {id_ for at, id_ in self.finished if at <= number}
            for kind, state in states.items():
                key = content_digest(repr((sorted(state.items()), sorted(finished))).encode())
                if key not in seen:
                    seen.add(key)
                    self._check_state(state, finished, f"before operation {number}, {what}: {kind}")
        return len(seen)

    def _check_state(self, state: State, finished: set[str], when: str) -> None:
        root = self.bench.folder / "after"
        put(state, root)
        run = Store(root / "run")
        with nullcontext() if finished else suppress(StoreError):
            run.read_plan()
        sound, _ = run.sound_entries(cell.id for cell in self.plan.cells)
        lost = finished - {id_ for id_, entry in sound.items() if entry.status == "ok"}
        assert not lost, f"{when}: {lost} of {finished}"
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(atomic, "os", Hasty())
            patch.setattr(atomic, "_libc", Hasty())
            summary = self.bench.run(self.plan, "after/run", workers=1)
        assert summary.statuses == {"ok": len(self.plan.cells)}, when
        assert summary.kept >= len(finished), when
        assert contents(run, self.plan) == self.expected, when
        assert not run.environments.damaged(), when
        assert not list(root.rglob(".*")), when
        shutil.rmtree(root)


@pytest.fixture
def cuts(bench: Bench, plan: Plan) -> Cuts:
    bench.run(plan, "whole", workers=1)
    return Cuts(bench, plan, contents(bench.store("whole"), plan))


@pytest.mark.thorough
def test_a_cell_that_was_waited_for_is_there_after_a_cut_at_any_moment(
    cuts: Cuts, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(store, "_DURABLE_FROM_S", 0.0)
    cuts.run()
    assert len(cuts.finished) == len(cuts.plan.cells)
    assert cuts.finished[0][0] < cuts.finished[1][0] < len(cuts.disk.moments)
    assert cuts.check() > 80


@pytest.mark.slow
def test_quick_cells_are_there_when_the_run_has_ended(cuts: Cuts) -> None:
    cuts.run()
    cuts.finished = [(len(cuts.disk.moments) - 1, id_) for _, id_ in cuts.finished]
    assert len(cuts.finished) == len(cuts.plan.cells)
    assert cuts.check() > 20


def damage(paths: Iterable[Path]) -> None:
    for path in paths:
        path.write_bytes(path.read_bytes()[:-20])


@pytest.mark.slow
def test_what_was_there_before_a_run_that_mends_is_there_after_a_cut_at_any_moment(
    cuts: Cuts, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(store, "_DURABLE_FROM_S", 0.0)
    folder = cuts.bench.folder / "disk" / "run"
    cuts.bench.run(cuts.plan, "disk/run", workers=1)
    hurt = {cell.id for cell in cuts.plan.cells[:1]}
    damage(Store(folder).record_folder(id_) / "record.json" for id_ in hurt)
    damage((folder / "environment").iterdir())
    damage((folder / "coded").iterdir())
    cuts.finished = [(0, cell.id) for cell in cuts.plan.cells if cell.id not in hurt]
    cuts.run()
    assert {id_ for _, id_ in cuts.finished} == {cell.id for cell in cuts.plan.cells}
    assert cuts.check() > 80
