"""Damage of every kind of file in a run folder: mended by the next run or left out with a reason, never silent."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from distributions import register
from project import SUPPORT
from warm_command import run_warm

from codecbench.core.analysis.collect import open_run
from codecbench.core.contracts.errors import StoreError
from codecbench.core.engine.identity import digest
from codecbench.core.engine.planning.matrix import read_matrix
from codecbench.core.engine.planning.model import Plan
from codecbench.core.engine.planning.plan import make_plan
from codecbench.core.engine.plugins.registry import installed
from codecbench.core.engine.running.run import run_plan
from codecbench.core.engine.storage.bitstream_file import BitstreamDamage, BitstreamFile
from codecbench.core.engine.storage.record import RecordDamage, record_from_bytes
from codecbench.core.engine.storage.store import Store

MATRIX = """
version: 1
name: small
sequences: [{use: ramp, params: {frames: 3}}]
codecs: [{use: shift, params: {bits: {grid: [0, 3]}}}]
evaluators: [error, diary]
run: {workers: 1}
"""
DIARY = '''
from codecbench import Measurement, Metric, NoParams, PluginSpec, SequenceEvaluator, hookimpl


class Diary(SequenceEvaluator[NoParams]):
    """Leaves a file, and measures its content where tables are built."""

    name = "diary"
    version = "1"
    params_type = NoParams
    metrics = (Metric("sum", "1", "neither", "of the file's bytes"), Metric("size", "bytes", "lower", "of all"))

    def evaluate(self, coded, context):
        sizes = [coded.size_bytes(index) for index in range(len(coded))]
        (context.artifacts / "diary.txt").write_text(f"{sizes} {coded.codec.params.bits}")
        yield Measurement("size", float(sum(sizes)))

    def compare(self, outcome, baseline):
        yield Measurement("sum", float(sum((outcome.artifacts / "diary.txt").read_bytes())))


@hookimpl
def codecbench_evaluators():
    return [PluginSpec("diary", "diary:Diary", "leaves a file")]
'''
KINDS = {
    "environment": "environment/*.json",
    "record": "records/*/*/record.json",
    "samples": "records/*/*/frames.parquet",
    "artifact": "records/*/*/diary.txt",
    "index": "records/index.jsonl",
    "bitstreams": "coded/*.bits",
    "encoder": "coded/*.code",
    "plan": "plan.json",
    "matrix": "matrix.yaml",
}
CODED = ("bitstreams", "encoder")
"""Kinds that no table reads, and a run only where it needs bitstreams."""
FLIPS = 200


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("damage") / "site"
    folder.mkdir()
    shutil.copy(SUPPORT / "plain_plugins.py", folder)
    (folder / "diary.py").write_text(DIARY)
    register(folder, "plain", "1", "plain_plugins")
    register(folder, "diary", "1", "diary")
    (folder.parent / "small.yaml").write_text(MATRIX)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        installed.cache_clear()
        yield folder
    installed.cache_clear()


@pytest.fixture(scope="module")
def plan(site: Path) -> Plan:
    return make_plan(read_matrix(site.parent / "small.yaml"))


@pytest.fixture(scope="module")
def whole(site: Path, plan: Plan) -> Path:
    """A finished run, never touched."""
    run_plan(plan, site.parent / "whole", workers=1)
    return site.parent / "whole"


@pytest.fixture
def folder(whole: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(whole, tmp_path / "run"))


def command(site: Path, *words: str | Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(site), "COLUMNS": "200"}
    done = run_warm(words, site.parent, environment)
    assert "Traceback" not in done.stderr + done.stdout, done.stderr + done.stdout
    return done


def table(folder: Path) -> str:
    """Everything that tables show of a run."""
    result = open_run(folder)
    return result.wide.to_csv() + result.tidy.to_csv() + str(result.environments)


def shown(folder: Path, caplog: pytest.LogCaptureFixture) -> tuple[str | None, str]:
    """What tables show, None where they are refused, and what is said meanwhile."""
    caplog.clear()
    try:
        found = table(folder)
    except StoreError as error:
        return None, str(error)
    return found, caplog.text


def sound(folder: Path, plan: Plan) -> bool:
    """Whether every file of a run is as it should be, by what each says of itself."""
    store = Store(folder)
    records, damaged = store.sound_entries(cell.id for cell in plan.cells)
    coded = all(store.has_coded(job.id, job.sequence.frames) for job in plan.jobs)
    return len(records) == len(plan.cells) and not damaged and coded and not store.environments.damaged()


def flips(path: Path, count: int, seed: int) -> Iterator[int]:
    """Change one bit of a file after another, and give the bit; the file is whole again at the end.

    It is changed where it lies: a file that is emptied and written again waits for the disk.
    """
    content = path.read_bytes()
    for position in np.random.default_rng(seed).integers(0, 8 * len(content), count).tolist():
        at, bit = divmod(position, 8)
        _write_at(path, at, content[at] ^ 1 << bit)
        yield position
        _write_at(path, at, content[at])


def _write_at(path: Path, at: int, value: int) -> None:
    with open(path, "r+b") as file:
        file.seek(at)
        file.write(bytes([value]))


def noticed_by_resuming(folder: Path, plan: Plan, caplog: pytest.LogCaptureFixture) -> bool:
    """Whether the next run would find damage, by what it looks at before it starts."""
    store = Store(folder)
    caplog.clear()
    _, damaged = store.sound_entries(cell.id for cell in plan.cells)
    return bool(damaged or store.environments.damaged())


@pytest.mark.thorough
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in CODED])
def test_no_flipped_bit_changes_a_table_silently(
    kind: str, folder: Path, plan: Plan, caplog: pytest.LogCaptureFixture
) -> None:
    expected, words = shown(folder, caplog)
    assert expected is not None
    assert not words
    paths = sorted(folder.glob(KINDS[kind]))
    unnoticed = []
    for number, path in enumerate(paths):
        for bit in flips(path, FLIPS // len(paths), number):
            found, words = shown(folder, caplog)
            if found != expected:
                assert words, f"{path.name}, bit {bit}: the table changed and nothing was said"
            elif not words and not noticed_by_resuming(folder, plan, caplog):
                unnoticed.append((path.name, bit))
    if kind == "index":  # a copy, of which damaged lines are read from the records instead
        assert shown(folder, caplog)[0] == expected
    else:
        assert not unnoticed


@pytest.mark.thorough
def test_every_flipped_bit_of_bitstreams_is_noticed_where_they_are_read(folder: Path, plan: Plan) -> None:
    for number, job in enumerate(plan.jobs):
        path = Store(folder).coded_path(job.id)
        for bit in flips(path, FLIPS // len(plan.jobs), number):
            try:
                file = BitstreamFile(path, job.id)
                [file.read(index) for index in range(len(file))]
            except BitstreamDamage:
                continue
            pytest.fail(f"bit {bit} was not noticed")


@pytest.mark.thorough
def test_every_flipped_bit_of_a_note_of_who_encoded_is_noticed(folder: Path, plan: Plan) -> None:
    for number, job in enumerate(plan.jobs):
        path = Store(folder).coded_path(job.id).with_suffix(".code")
        known = Store(folder).encoders.read(job.id)
        assert known
        for bit in flips(path, FLIPS // len(plan.jobs), number):
            store = Store(folder)
            assert store.encoders.read(job.id) == known or store.encoders.damaged(job.id), bit
        assert Store(folder).has_coded(job.id, job.sequence.frames)


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=pytest.mark.thorough if kind == "record" else pytest.mark.slow) for kind in KINDS]
)
def test_the_next_run_mends_what_was_damaged(kind: str, folder: Path, whole: Path, plan: Plan, site: Path) -> None:
    """The environment where something is computed in it."""
    expected = table(whole)
    path = sorted(folder.glob(KINDS[kind]))[0]
    for bit in flips(path, 1, 7):
        before = command(site, "table", folder)
        again = ["--recompute", "error"] if kind in (*CODED, "environment") else []
        done = command(site, "run", "small.yaml", "--out", folder, "--quiet", *again)
        assert done.returncode == 0, done.stderr
        assert sound(folder, plan), (kind, bit)
        assert table(folder) == expected
        said = before.stderr + done.stderr + (folder / "run.log").read_text()
        assert kind == "index" or "damaged" in said or "again" in said, said
        assert kind != "encoder" or "its encoder" in said


@pytest.mark.thorough
def test_two_bitstream_files_that_changed_places_are_noticed(folder: Path, plan: Plan, site: Path) -> None:
    expected = table(folder)
    first, second = (Store(folder).coded_path(job.id) for job in plan.jobs)
    first.rename(folder / "aside")
    second.rename(first)
    (folder / "aside").rename(second)
    done = command(site, "run", "small.yaml", "--out", folder, "--quiet", "--recompute", "error")
    assert done.returncode == 0
    said = (folder / "run.log").read_text()
    assert said.count("be encoded again") == 2
    assert f"job {plan.jobs[1].id}, not of {plan.jobs[0].id}" in said
    assert table(folder) == expected


@pytest.mark.thorough
def test_an_environment_of_another_machine_that_is_damaged_is_left_out_every_time(folder: Path, site: Path) -> None:
    path = next((folder / "environment").iterdir())
    foreign = path.rename(path.with_name("0123456789abcdef.json"))
    for _ in range(2):
        done = command(site, "run", "small.yaml", "--out", folder)
        assert done.returncode == 0
        assert f"{foreign.name} is damaged" in done.stderr
        assert f"it describes environment {path.stem}" in done.stderr


def replaced(name: str, value: object) -> Callable[[dict[str, object]], object]:
    return lambda body: body.__setitem__(name, value)


OTHER_SHAPES = pytest.mark.parametrize(
    ("change", "words"),
    [
        *((lambda body, name=name: body.pop(name), f"{name}: Field required") for name in ("status", "files", "cell")),
        (replaced("status", "splendid"), "status: Input should be 'ok'"),
        (replaced("duration_s", "long"), "duration_s: Input should be a valid number"),
        (replaced("measurements", [["sum", 1.0]]), "measurements.0.2: Field required"),
        (replaced("summaries", [["max_error", "", "max", "many"]]), "summaries.0.3"),
        (replaced("cell", {"codec": []}), "cell.codec"),
        (replaced("files", {"../../plan.json": {"size": 1, "digest": ""}}), "files"),
        (replaced("environment", 7), "environment: Input should be a valid string"),
    ],
)  # fmt: skip


def reshaped(folder: Path, change: Callable[[dict[str, object]], object]) -> tuple[Path, bytes]:
    """A record's file, and its content with a change and the checksum of what it is then."""
    path = sorted(folder.glob(KINDS["record"]))[0]
    body = json.loads(path.read_text())
    del body["checksum"]
    change(body)
    return path, json.dumps({"checksum": digest(body), **body}).encode()


@pytest.mark.thorough
@OTHER_SHAPES
def test_a_record_of_another_shape_is_damage_though_its_checksum_is_right(
    change: Callable[[dict[str, object]], object], words: str, folder: Path
) -> None:
    with pytest.raises(RecordDamage, match=words):
        record_from_bytes(reshaped(folder, change)[1])


@pytest.mark.slow
@OTHER_SHAPES
def test_a_table_leaves_out_a_record_of_another_shape_and_a_run_makes_it_again(
    change: Callable[[dict[str, object]], object], words: str, folder: Path, plan: Plan, site: Path
) -> None:
    path, content = reshaped(folder, change)
    path.write_bytes(content)
    (folder / "records" / "index.jsonl").unlink()
    assert "its record" in (stderr := command(site, "table", folder).stderr) or "record.json" in stderr
    if words.startswith("status: Field"):
        assert command(site, "run", "small.yaml", "--out", folder, "--quiet").returncode == 0
        assert sound(folder, plan)


@pytest.mark.thorough
@pytest.mark.parametrize("literal", ["NaN", "1e999", "[" * 100_000])
def test_what_is_no_json_is_refused(literal: str, folder: Path, site: Path) -> None:
    path = folder / "plan.json"
    path.write_text(f'{{"checksum": "", "plan": {literal}}}')
    done = command(site, "table", folder)
    assert done.returncode == 3
    assert f"{path.name} is damaged" in done.stderr
