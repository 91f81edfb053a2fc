"""Faults, injected: each costs its cell, is recorded with its reason, and disturbs nothing else."""

from __future__ import annotations

import errno
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil
import pytest
from engine_bench import HERE, Bench, bench_in, bench_without_processes, contents, grid, matrix, write_stack
from project import SUPPORT

from codecbench.core.contracts.errors import StoreError
from codecbench.core.engine.storage import atomic
from codecbench.core.engine.storage.record import RecordDamage
from codecbench.core.engine.storage.store import Store

CODEC_FAULTS = {
    "raise": ("failed", r"^encode, frame 2: ZeroDivisionError: divided by nothing"),
    "full": ("failed", r"^encode, frame 2: OSError: \[Errno 28\] no room"),
    "exit": ("failed", r"^encode, frame 2: SystemExit: leaving"),
    "leave": ("crashed", r"^encode: .* status 0$"),
    "segfault": ("crashed", r"^encode: .* SIGSEGV$"),
    "abort": ("crashed", r"^encode: .* SIGABRT$"),
    "hang": ("timed_out", r"^no result within 15 s"),
    "hog": ("failed", r"^encode, frame 2: "),
    "drip": ("failed", r"^encode, frame 2: "),
    "text": ("failed", r"^encode, frame 2: encode returned str"),
    "empty": ("failed", r"^encode, frame 2: encode returned no bytes"),
    "leak": ("ok", ""),
    "fork": ("ok", ""),
    "noise": ("ok", ""),
    "scribble": ("ok", ""),
}
DECODE_FAULTS = {
    "misread": ("failed", r"^decode, frame 2: no such marker$"),
    "shape": ("failed", r"^decode, frame 2: decode returned .*\(15, 24\).*\(16, 24\)$"),
    "dtype": ("failed", r"^decode, frame 2: decode returned .*float64.*uint8$"),
    "nan": ("failed", r"^decode, frame 2: decode returned .*float32.*uint8$"),
    "nothing": ("failed", r"^decode, frame 2: decode returned NoneType"),
    "remark": ("failed", r"^remark: remark returned 7"),
    "memory": ("failed", r"^decode, frame 2: AttributeError: .*'last_shape'$"),
}
EVALUATOR_FAULTS = {
    "none": ("ok", ""),
    "nan": ("failed", "evaluate, frame 2: error: NaN without a reason"),
    "reasoned_nan": ("ok", ""),
    "infinite": ("ok", ""),
    "undeclared": ("failed", "evaluate, frame 2: metric 'surprise' .*error, note"),
    "text": ("failed", "evaluate, frame 2: error: .*got str"),
    "bool": ("failed", "evaluate, frame 2: error: .*got bool"),
    "tuple": ("failed", "evaluate, frame 2: yielded tuple"),
    "frame": ("failed", "evaluate, frame 2: error: .*frame 2 .*frame 7"),
    "raise": ("failed", "evaluate, frame 2: KeyError: 'gone'"),
    "sleep": ("timed_out", "no result within 15 s"),
}
WHOLE_FAULTS = {
    "none": ("ok", ""),
    "raise": ("failed", "evaluate, frame 2: RuntimeError: lost the thread"),
    "folder": ("failed", "artifacts: .*'nested' is a folder"),
    "undeclared_plugin": ("failed", "codec 'faulty' .*not declared"),
}


LIMITS = "workers: 2, timeout_s: 600, memory_mb: 400"
"""Room for 200 MB that a codec leaks, beside the processes of its host and of the dataset's."""
SHORT = "workers: 1, timeout_s: 15"
"""For what hangs, alone: a limit that nothing else reaches on a busy machine would be long to wait for."""


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with bench_in(tmp_path, workers=1) as made:
        yield made


@pytest.fixture
def bench_here(tmp_path: Path) -> Iterator[Bench]:
    with bench_without_processes(tmp_path) as made:
        yield made


def unblamed(reason: str) -> str:
    """A reason without the plugins that it names."""
    plugin = r"(dataset|codec|evaluator) \w+ of faults 1\.0"
    return re.sub(rf"{plugin}( or {plugin})*( while (encoding|evaluating))?: ", "", reason)


def children_called_sleep(folder: Path) -> list[psutil.Process]:
    """Those that codecs of the test in that folder started: other tests may run beside it, and have such children."""
    found = [one for one in psutil.process_iter(["cmdline", "environ"]) if one.info["cmdline"] == ["sleep", "300"]]
    return [one for one in found if (one.info["environ"] or {}).get("FAULTS_IN") == str(folder)]


@pytest.mark.thorough
def test_every_codec_fault_costs_its_own_cells_alone(
    bench: Bench, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAULTS_IN", str(bench.folder))
    plan = bench.plan(matrix(grid("faulty", [*(CODEC_FAULTS.keys() - {"hang"}), "none"]), "wandering", LIMITS))
    summary = bench.run(plan, workers=2)
    hanging = bench.plan(matrix(grid("faulty", ["hang"]), "wandering", SHORT))
    bench.run(hanging)
    for cell, record in (*bench.records(plan).values(), *bench.records(hanging).values()):
        status, reason = CODEC_FAULTS.get(cell.codec.params["fault"], ("ok", ""))
        if cell.codec.params["fault"] == "drip" and record.status == "crashed":  # seen from outside before its limit
            assert "memory_mb allows 400" in record.reason
            continue
        assert record.status == status, cell.codec.label
        assert re.search(reason, unblamed(record.reason).removeprefix("coding failed: ")), record.reason
        assert record.reason.startswith("coding failed: ") or status == "ok"
        assert "faulty of faults 1.0" in record.reason or status == "ok"
        assert record.reason or status == "ok"
        if status == "ok":
            assert [(one, value) for (one, _, _), value in record.summaries.items()] == [("error", 0.0)]
    assert sum(summary.statuses.values()) == len(plan.cells)
    assert not children_called_sleep(bench.folder)
    assert capfd.readouterr() == ("", "")
    lines = bench.store().log_path.read_text().splitlines()
    bad = sum(status != "ok" for status, _ in CODEC_FAULTS.values())
    assert sum("WARNING" in line for line in lines) == bad


@pytest.mark.thorough
def test_every_decoder_fault_names_its_frame(bench: Bench) -> None:
    plan = bench.plan(matrix(grid("faulty", [*DECODE_FAULTS, "jump", "none"]), "wandering", "timeout_s: 600"))
    bench.run(plan)
    for cell, record in bench.records(plan).values():
        expected = DECODE_FAULTS.get(cell.codec.params["fault"])
        if expected is not None:
            assert record.status == expected[0], record.reason
            assert re.search(expected[1], unblamed(record.reason)), record.reason
            assert "Traceback" in record.traceback
        elif cell.codec.params["fault"] == "jump":
            assert record.status == "crashed"
            assert re.search(r"^decode: .* SIGSEGV$", unblamed(record.reason)), record.reason
            assert "decode_jump" in record.traceback
        else:
            assert record.status == "ok"


@pytest.mark.thorough
def test_every_evaluator_fault_fails_the_cell(bench: Bench) -> None:
    evaluators = f"{grid('wandering', EVALUATOR_FAULTS.keys() - {'sleep'})}, {grid('whole', WHOLE_FAULTS)}"
    codec = "{use: faulty, params: {step: 2}}"
    plan = bench.plan(matrix(codec, evaluators, LIMITS))
    bench.run(plan)
    hanging = bench.plan(matrix(codec, grid("wandering", ["sleep"]), SHORT))
    bench.run(hanging)
    for cell, record in (*bench.records(plan).values(), *bench.records(hanging).values()):
        faults = EVALUATOR_FAULTS if cell.evaluator.name == "wandering" else WHOLE_FAULTS
        status, reason = faults[cell.evaluator.params["fault"]]
        assert record.status == status, record.reason
        assert re.search(reason, unblamed(record.reason)), record.reason
        if cell.evaluator.params["fault"] == "none" and cell.evaluator.name == "wandering":
            assert record.summaries["error", "", "mean"] == pytest.approx(1.5, abs=0.1)  # 2 bits dropped: 0..3


@pytest.mark.thorough
def test_failed_cells_are_tried_again_and_good_ones_kept(bench_here: Bench) -> None:
    text = matrix(grid("faulty", ["raise", "none"]), "wandering", HERE)
    assert bench_here.run(text).statuses == {"failed": 1, "ok": 1}
    again = bench_here.run(text)
    assert (again.computed, again.kept, again.statuses) == (1, 1, {"failed": 1, "ok": 1})


@pytest.mark.thorough
def test_a_changed_sequence_is_computed_anew(bench: Bench) -> None:
    text = matrix("faulty", "wandering")
    plan = bench.plan(text)
    assert bench.run(plan).computed == 1
    write_stack(bench.folder / "stack.npy", seed=1)
    again = bench.run(bench.plan(text))
    assert (again.computed, again.kept, again.encoded) == (1, 0, 1)
    write_stack(bench.folder / "stack.npy", seed=2)
    late = bench.run(plan, "late")
    assert late.statuses == {"failed": 1}
    [(_, record)] = bench.records(plan, "late").values()
    assert re.search(r"^coding failed: open: stack has changed", unblamed(record.reason))


def damage(path: Path, how: str) -> None:
    content = bytearray(path.read_bytes())
    if how == "flip":
        content[len(content) // 2] ^= 4
    path.write_bytes(content[: len(content) // 2] if how == "truncate" else content)


@pytest.mark.thorough
def test_damaged_records_are_found_reported_and_computed_again(bench_here: Bench) -> None:
    plan = bench_here.plan(matrix(grid("faulty", "abc"), "wandering, whole", HERE))
    bench_here.run(plan)
    store, before = bench_here.store(), contents(bench_here.store(), plan)
    of = {name: [cell for cell in plan.cells if cell.evaluator.name == name] for name in ("wandering", "whole")}
    victims = {
        of["wandering"][0].id: ("frames.parquet", "flip"),
        of["wandering"][1].id: ("frames.parquet", "truncate"),
        of["whole"][0].id: ("record.json", "flip"),
        of["whole"][1].id: ("record.json", "truncate"),
        of["whole"][2].id: ("total.txt", "flip"),
    }
    for cell_id, (name, how) in victims.items():
        damage(store.record_folder(cell_id) / name, how)
        with pytest.raises(RecordDamage, match=name):
            read_everything(store, cell_id)
    again = bench_here.run(plan)
    assert set(again.damaged) == set(victims)
    assert (again.computed, again.kept, again.encoded) == (5, 1, 0)
    log = store.log_path.read_text()
    assert all(cell_id in log for cell_id in victims)
    assert contents(store, plan) == before
    assert bench_here.run(plan).kept == 6


def read_everything(store: Store, cell_id: str) -> None:
    record = store.read_record(cell_id)
    for name in record.files:
        store.read_file(record, name)


@pytest.mark.thorough
def test_damaged_bitstreams_are_encoded_again(bench_here: Bench) -> None:
    codecs = grid("faulty", "abcd")
    plan = bench_here.plan(matrix(codecs, "wandering", HERE))
    bench_here.run(plan)
    flipped, cut, gone, _ = [bench_here.store().coded_path(job.id) for job in plan.jobs]
    damage(flipped, "flip")
    damage(cut, "truncate")
    gone.unlink()
    more = bench_here.plan(matrix(codecs, "wandering, whole", HERE))
    again = bench_here.run(more)
    assert (again.statuses, again.encoded, again.kept) == ({"ok": 8}, 3, 4)
    log = bench_here.store().log_path.read_text()
    assert [path.stem in log for path in (flipped, cut, gone)] == [True, True, False]
    bench_here.run(more, "undisturbed")
    assert contents(bench_here.store(), more) == contents(bench_here.store("undisturbed"), more)


@pytest.mark.thorough
@pytest.mark.parametrize("how", ["flip", "truncate", "remove"])
def test_a_damaged_index_is_made_again_from_the_records(bench_here: Bench, how: str) -> None:
    plan = bench_here.plan(matrix(grid("faulty", "ab"), "wandering, whole", HERE))
    bench_here.run(plan)
    path = bench_here.store().records_folder / "index.jsonl"
    if how == "remove":
        path.unlink()
    else:
        damage(path, how)
    assert set(bench_here.store().entries()) == {cell.id for cell in plan.cells}
    assert bench_here.run(plan).kept == 4


@pytest.mark.thorough
@pytest.mark.parametrize("how", ["flip", "truncate"])
def test_a_damaged_plan_is_said_to_be_and_written_again(bench_here: Bench, how: str) -> None:
    plan = bench_here.plan(matrix("faulty", "wandering", HERE))
    bench_here.run(plan)
    assert bench_here.store().read_plan() == plan
    damage(bench_here.folder / "run" / "plan.json", how)
    with pytest.raises(StoreError, match=r"plan\.json .*damaged"):
        bench_here.store().read_plan()
    assert bench_here.run(plan).kept == 1
    assert bench_here.store().read_plan() == plan


@pytest.mark.thorough
def test_a_full_disk_ends_the_run_and_loses_nothing(bench_here: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = bench_here.plan(matrix(grid("faulty", "abc"), "wandering, whole", HERE))
    fsync = os.fsync

    def full(*arguments: Any) -> Any:
        if len(bench_here.store().entries()) >= 3:
            raise OSError(errno.ENOSPC, "No space left on device")
        return fsync(*arguments)

    monkeypatch.setattr("codecbench.core.engine.storage.store._DURABLE_FROM_S", 0.0)
    monkeypatch.setattr(atomic.os, "fsync", full)
    with pytest.raises(StoreError, match=f"{os.strerror(errno.ENOSPC)}; all earlier records"):
        bench_here.run(plan)
    monkeypatch.setattr(atomic.os, "fsync", fsync)
    assert not list((bench_here.folder / "run").rglob(".new-*"))
    again = bench_here.run(plan)
    assert (again.kept, again.statuses) == (3, {"ok": 6})
    bench_here.run(plan, "undisturbed")
    assert contents(bench_here.store(), plan) == contents(bench_here.store("undisturbed"), plan)


@contextmanager
def small_disk(folder: Path) -> Iterator[None]:
    """A file system of 96 kB at `folder`, where this machine lets this user make one."""
    folder.mkdir()
    words = ["mount", "-t", "tmpfs", "-o", "size=96k", "codecbench-test", str(folder)]
    mounted = subprocess.run(words, check=False, capture_output=True, text=True)
    if mounted.returncode:
        pytest.skip(f"no disk can be mounted here, which takes root: {mounted.stderr.strip()}")
    try:
        yield
    finally:
        subprocess.run(["umount", "--lazy", folder], check=True)


@pytest.mark.thorough
def test_a_disk_that_is_really_full_loses_nothing(bench_here: Bench) -> None:
    plan = bench_here.plan(
        matrix("{use: faulty, params: {step: {grid: [0, 1, 2, 3]}}}", "wandering, whole, slow", HERE)
    )
    with small_disk(bench_here.folder / "disk"):
        with pytest.raises(StoreError, match=os.strerror(errno.ENOSPC)):
            bench_here.run(plan, "disk/run")
        finished = [one.cell_id for one in bench_here.store("disk/run").entries().values() if one.status == "ok"]
        sound, damaged = bench_here.store("disk/run").sound_entries(cell.id for cell in plan.cells)
        assert finished
        assert len(finished) < len(plan.cells)
        assert not damaged
        subprocess.run(["mount", "-o", "remount,size=16m", bench_here.folder / "disk"], check=True)
        again = bench_here.run(plan, "disk/run")
        assert (again.kept, again.statuses) == (len(finished), {"ok": 12})
        assert set(finished) <= set(sound)
        bench_here.run(plan, "undisturbed")
        assert contents(bench_here.store("disk/run"), plan) == contents(bench_here.store("undisturbed"), plan)


@pytest.mark.thorough
def test_a_second_process_in_the_folder_is_refused_and_disturbs_nothing(bench: Bench) -> None:
    cells = "abcdef"
    plan = bench.plan(matrix(grid("faulty", cells), "slow"))
    command = [sys.executable, SUPPORT / "run_driver.py", bench.folder / "matrix.yaml"]
    first = subprocess.Popen([*map(str, command), str(bench.folder / "run"), str(bench.site)])
    deadline = time.monotonic() + 60
    while not bench.store().entries():
        assert time.monotonic() < deadline
        time.sleep(0.02)
    first.send_signal(signal.SIGSTOP)  # so that it holds the folder for as long as this looks
    with pytest.raises(StoreError, match=f"by process {first.pid} on "):
        bench.run(plan)
    first.send_signal(signal.SIGCONT)
    assert first.wait(60) == 0
    assert {entry.status for entry in bench.store().entries().values()} == {"ok"}
    assert bench.run(plan).kept == len(cells)
