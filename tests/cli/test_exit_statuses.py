"""What every command's exit status says, asked of the command in a process of its own."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil
import pytest
from distributions import install_source
from installed_command import COMMAND, TINY, Done, Place, tiny_place
from project import DOCS
from recordings import pictures

from codecbench import Measurement
from codecbench.cli import COMMANDS
from codecbench.cli.messages import ExitStatus
from codecbench.core.engine.identity import content_digest, digest
from codecbench.core.engine.storage.samples import parquet_from_samples

pytestmark = pytest.mark.thorough

CRASHING = """
import time
from plain_plugins import NULL_TRACE, Shift
from codecbench import PluginSpec, hookimpl

class Failing(Shift):
    name = "failing"
    def decode(self, bitstream, *, trace=NULL_TRACE):
        raise RuntimeError("broken on purpose")

class Slow(Shift):
    name = "slow"
    def encode(self, image, *, trace=NULL_TRACE):
        time.sleep(60)

@hookimpl
def codecbench_codecs():
    return [PluginSpec("failing", "odd:Failing", "raises"), PluginSpec("slow", "odd:Slow", "takes a minute")]
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Place:
    """Matrices, a finished run in `runs/tiny`, one that became worse, one without records, and a damaged one."""
    place = tiny_place(tmp_path_factory.mktemp("statuses"))
    install_source(place.site, "odd", "1", CRASHING)
    folder = place.folder
    for name in ("failing", "slow", "absent"):
        (folder / f"{name}.yaml").write_text(TINY.replace("shift", name).replace("tiny", name))
    (folder / "wrong.yaml").write_text(TINY.replace("shift", "shfit"))
    linked = TINY.replace("name: tiny", "name: linked").replace("evaluators: [error]", "evaluators: [delivery]")
    (folder / "linked.yaml").write_text(linked)
    assert place.call("run", "linked.yaml").status == ExitStatus.SUCCESS
    assert place.call("compare", "runs/tiny", "--save", "base.json").status == ExitStatus.SUCCESS
    (folder / "better.json").write_text(
        re.sub(r'"values": \[[^]]*\]', '"values": [-1.0]', (folder / "base.json").read_text())
    )
    elsewhere = re.sub(r'"sequence": "[^"]*"', '"sequence": "elsewhere"', (folder / "base.json").read_text())
    (folder / "elsewhere.json").write_text(elsewhere)
    (folder / "empty").mkdir()
    shutil.copy(folder / "runs" / "tiny" / "plan.json", folder / "empty")
    (folder / "damaged").mkdir()
    (folder / "damaged" / "plan.json").write_text("{}")
    (folder / "file").write_text("")
    pictures(folder / "recording", ["1.png", "2.png"])
    assert place.call("bundle", "runs/tiny", "--out", "tiny.bundle.zip").status == ExitStatus.SUCCESS
    shutil.copytree(folder / "runs" / "tiny", folder / "changed")
    another_error(folder / "changed")
    assert place.call("bundle", "changed").status == ExitStatus.SUCCESS
    return place


def another_error(run: Path) -> None:
    """Change what the records of a run say of its frames, with all checksums."""
    (run / "records" / "index.jsonl").unlink()
    for path in run.glob("records/*/*/record.json"):
        content = parquet_from_samples([Measurement("max_error", 5.0, frame) for frame in range(4)])
        (path.parent / "frames.parquet").write_bytes(content)
        record = json.loads(path.read_bytes())
        record["files"]["frames.parquet"] = {"size": len(content), "digest": content_digest(content)}
        del record["checksum"]
        path.write_text(json.dumps({"checksum": digest(record), **record}))


def spelled(done: Done) -> Done:
    """The same, after a look at what no command may print."""
    assert "Traceback" not in done.output, done.output
    return done


ROWS: list[tuple[ExitStatus, str, str]] = [
    (ExitStatus.SUCCESS, "run tiny.yaml", "1 ok"),
    (ExitStatus.FOUND, "run failing.yaml", "broken on purpose"),
    (ExitStatus.FOUND, "run failing.yaml --out again --fail-fast", "stopped at the first failure"),
    (ExitStatus.FOUND, "run absent.yaml", "here every cell is unsupported"),
    (ExitStatus.FOUND, "run absent.yaml --quiet", "unsupported (1): libabsent is not here; run: apt install libabsent"),
    (ExitStatus.WRONG_USE, "run wrong.yaml", "wrong.yaml:5:10: codecs[0].use: no codec is called 'shfit'"),
    (ExitStatus.WRONG_USE, "run", "Missing argument"),
    (ExitStatus.WRONG_USE, "run tiny.yaml --recompute nobody", "nobody"),
    (ExitStatus.NOT_POSSIBLE, "run tiny.yaml --out file/run", "a file is where a folder is expected"),
    (ExitStatus.SUCCESS, "try recording --codec jpeg:10 --for speed --minutes 0.1", "the report: file:///"),
    (ExitStatus.WRONG_USE, "try nowhere", "nowhere: no such file"),
    (ExitStatus.WRONG_USE, "try wrong.yaml", "wrong.yaml: is text, which no dataset recognizes"),
    (ExitStatus.WRONG_USE, "try recording --codec jpg:10", "did you mean 'jpeg'"),
    (ExitStatus.WRONG_USE, "try recording --codec jpeg:1000", "less than or equal to 100"),
    (ExitStatus.WRONG_USE, "try recording --for tracking", "--fov DEGREES"),
    (ExitStatus.WRONG_USE, "try recording --set stirde=2", "stirde"),
    (ExitStatus.NOT_POSSIBLE, "try recording --codec jpeg:10 --out file/run", "a file is where a folder is expected"),
    (ExitStatus.SUCCESS, "init --out begin.yaml", "codecbench run begin.yaml"),
    (ExitStatus.SUCCESS, "init --from recording --out -", "use: folder"),
    (ExitStatus.WRONG_USE, "init --out tiny.yaml", "already exists"),
    (ExitStatus.NOT_POSSIBLE, "init --out file/m.yaml", "a file is where a folder is expected"),
    (ExitStatus.SUCCESS, "examples", "reference"),
    (ExitStatus.SUCCESS, "examples first", "jpeg2000"),
    (ExitStatus.WRONG_USE, "examples frist", "did you mean 'first'"),
    (ExitStatus.SUCCESS, "plan tiny.yaml", "cells: 1: 1 done"),
    (ExitStatus.WRONG_USE, "plan wrong.yaml", "did you mean 'shift'"),
    (ExitStatus.SUCCESS, "list codecs", "shift"),
    (ExitStatus.WRONG_USE, "list nonsense", "is not one of"),
    (ExitStatus.SUCCESS, "schema shift", "bits"),
    (ExitStatus.WRONG_USE, "schema shfit", "did you mean 'shift'"),
    (ExitStatus.SUCCESS, "table runs/tiny", "shift"),
    (ExitStatus.WRONG_USE, "table nowhere", "is not a run folder"),
    (ExitStatus.WRONG_USE, "table empty", "has no results yet"),
    (ExitStatus.NOT_POSSIBLE, "table damaged", "is damaged"),
    (ExitStatus.NOT_POSSIBLE, "table file", "Not a directory"),
    (ExitStatus.NOT_POSSIBLE, "table runs/tiny --format csv --out file/t.csv", "a file is where a folder is expected"),
    (ExitStatus.SUCCESS, "power runs/tiny", "nothing to rank"),
    (ExitStatus.WRONG_USE, "power", "Missing argument"),
    (ExitStatus.WRONG_USE, "power runs/tiny --power 2", "is not in the range"),
    (ExitStatus.NOT_POSSIBLE, "power damaged", "is damaged"),
    (ExitStatus.SUCCESS, "apply runs/tiny --codec shift", "codecbench.codec('shift'"),
    (ExitStatus.WRONG_USE, "apply runs/tiny --codec jpeg", "the run has no codec jpeg; it has: shift"),
    (ExitStatus.NOT_POSSIBLE, "apply damaged", "is damaged"),
    (ExitStatus.SUCCESS, "choose runs/linked --link ideal --deadline 10ms", "use shift"),
    (ExitStatus.WRONG_USE, "choose runs/linked --link lte --deadline 10ms", "it has ideal"),
    (ExitStatus.WRONG_USE, "choose runs/linked --link ideal", "give a deadline"),
    (ExitStatus.WRONG_USE, "choose runs/linked --link ideal --deadline 10", "is not a positive number"),
    (ExitStatus.WRONG_USE, "choose nowhere --link ideal --deadline 10ms", "is not a run folder"),
    (ExitStatus.SUCCESS, "choose tiny.yaml --link ideal --deadline 10ms --out chosen", "use shift"),
    (ExitStatus.FOUND, "choose absent.yaml --link ideal --deadline 10ms --out unchosen", "every cell is unsupported"),
    (ExitStatus.WRONG_USE, "choose wrong.yaml --link ideal --deadline 10ms", "did you mean 'shift'"),
    (ExitStatus.WRONG_USE, "choose nowhere.yaml --link ideal --deadline 10ms", "no such file"),
    (ExitStatus.WRONG_USE, "choose tiny.yaml --link lite --deadline 10ms", "no link is called 'lite'"),
    (ExitStatus.WRONG_USE, "choose runs/linked --link ideal --deadline 10ms --workers 2", "--workers needs a matrix"),
    (ExitStatus.NOT_POSSIBLE, "choose tiny.yaml --link ideal --deadline 10ms --out file/run", "a file is where"),
    (ExitStatus.NOT_POSSIBLE, "choose damaged --link ideal --deadline 10ms", "is damaged"),
    (ExitStatus.SUCCESS, "rank runs/tiny", "Nothing can be recommended"),
    (ExitStatus.SUCCESS, "rank runs/tiny --rate 0.5", "nothing to rank"),
    (ExitStatus.WRONG_USE, "rank runs/tiny --rate 0", "is not in the range"),
    (ExitStatus.SUCCESS, "rank runs/tiny --format json", "[]"),
    (ExitStatus.WRONG_USE, "rank", "Missing argument"),
    (ExitStatus.WRONG_USE, "rank nowhere", "is not a run folder"),
    (ExitStatus.WRONG_USE, "rank empty", "has no results yet"),
    (ExitStatus.WRONG_USE, "rank runs/tiny --format nonsense", "is not one of"),
    (ExitStatus.NOT_POSSIBLE, "rank damaged", "is damaged"),
    (ExitStatus.NOT_POSSIBLE, "rank file", "Not a directory"),
    (ExitStatus.SUCCESS, "report runs/tiny --format md", "report.md"),
    (ExitStatus.SUCCESS, "report runs/tiny --format markdown", "report.md"),
    (ExitStatus.SUCCESS, "table runs/tiny --format md", "| shift |"),
    (ExitStatus.SUCCESS, "report runs/tiny --frames 1", "report.html"),
    (ExitStatus.WRONG_USE, "report runs/tiny --frames 1,last", "is not a list of frame numbers such as 0,57,212"),
    (ExitStatus.WRONG_USE, "report runs/tiny --frames 999", "no sequence of the run has frame 999"),
    (ExitStatus.WRONG_USE, "report nowhere", "is not a run folder"),
    (ExitStatus.WRONG_USE, "report empty", "has no results yet"),
    (ExitStatus.NOT_POSSIBLE, "report damaged", "is damaged"),
    (ExitStatus.NOT_POSSIBLE, "report runs/tiny --format md --out file/r.md", "a file is where a folder is expected"),
    (ExitStatus.SUCCESS, "plot runs/tiny", ""),
    (ExitStatus.WRONG_USE, "plot empty", "has no results yet"),
    (ExitStatus.NOT_POSSIBLE, "plot damaged", "is damaged"),
    (ExitStatus.NOT_POSSIBLE, "plot runs/tiny --out file/figures", "a file is where a folder is expected"),
    (ExitStatus.SUCCESS, "compare runs/tiny base.json", "same: all 1 series"),
    (ExitStatus.FOUND, "compare better.json runs/tiny", "worse"),
    (ExitStatus.SUCCESS, "compare better.json runs/tiny --fail-on never", "worse"),
    (ExitStatus.FOUND, "compare empty empty", "nothing to compare"),
    (ExitStatus.FOUND, "compare elsewhere.json runs/tiny", "the runs have nothing in common"),
    (ExitStatus.SUCCESS, "compare elsewhere.json runs/tiny --fail-on never", "the runs have nothing in common"),
    (ExitStatus.WRONG_USE, "compare runs/tiny", "give a second run"),
    (ExitStatus.WRONG_USE, "compare nowhere runs/tiny", "neither a run folder nor a baseline file"),
    (ExitStatus.NOT_POSSIBLE, "compare damaged runs/tiny", "is damaged"),
    (ExitStatus.NOT_POSSIBLE, "compare runs/tiny --save file/base.json", "a file is where a folder is expected"),
    (ExitStatus.SUCCESS, "status runs/failing --failed", "1 failed"),
    (ExitStatus.SUCCESS, "status empty", "1 to do"),
    (ExitStatus.WRONG_USE, "status nowhere", "is not a run folder"),
    (ExitStatus.NOT_POSSIBLE, "status damaged", "is damaged"),
    (ExitStatus.WRONG_USE, "reproduce nowhere", "is not a run folder"),
    (ExitStatus.WRONG_USE, "reproduce empty", "has no results yet"),
    (ExitStatus.NOT_POSSIBLE, "reproduce damaged", "is damaged"),
    (ExitStatus.NOT_POSSIBLE, "reproduce runs/tiny --out file/page.md", "a file is where a folder is expected"),
    (ExitStatus.SUCCESS, "data list", "kodak"),
    (ExitStatus.WRONG_USE, "data path kodack", "did you mean kodak?"),
    (ExitStatus.SUCCESS, "warm-up tiny.yaml", "0 failed"),
    (ExitStatus.WRONG_USE, "warm-up wrong.yaml", "did you mean 'shift'"),
    (ExitStatus.SUCCESS, "verify raw --only params", "1 passed"),
    (ExitStatus.FOUND, "verify failing --only shape", "broken on purpose"),
    (ExitStatus.WRONG_USE, "verify nobody", "no codec is called 'nobody'"),
    (ExitStatus.NOT_POSSIBLE, "verify --check-corpus nowhere", "is not the manifest of a corpus"),
    (ExitStatus.NOT_POSSIBLE, "verify raw --only params --json file/r.json", "a file is where a folder is expected"),
    (ExitStatus.SUCCESS, "export runs/tiny --codec shift --out pictures", "pictures: 4 files"),
    (ExitStatus.WRONG_USE, "export runs/tiny --codec nobody --out pictures", "it has: shift  on ramp"),
    (ExitStatus.WRONG_USE, "export runs/tiny --codec shift --out video.mp4", "not a video codec"),
    (ExitStatus.WRONG_USE, "export nowhere --codec shift --out pictures", "is not a run folder"),
    (ExitStatus.NOT_POSSIBLE, "export damaged --codec shift --out pictures", "is damaged"),
    (ExitStatus.NOT_POSSIBLE, "export runs/tiny --codec shift --out file/pictures", "a file is where a folder"),
    (ExitStatus.SUCCESS, "bundle runs/tiny --out new.zip", "SHA-256"),
    (ExitStatus.WRONG_USE, "bundle nowhere", "is not a run folder"),
    (ExitStatus.WRONG_USE, "bundle empty", "has no results yet"),
    (ExitStatus.NOT_POSSIBLE, "bundle damaged", "is damaged"),
    (ExitStatus.NOT_POSSIBLE, "bundle runs/tiny --out file/b.zip", "a file is where a folder is expected"),
    (ExitStatus.SUCCESS, "open tiny.bundle.zip --out opened", "report: opened/report/report.html"),
    (ExitStatus.WRONG_USE, "open nowhere.zip", "there is no such file"),
    (ExitStatus.WRONG_USE, "open tiny.bundle.zip --out runs/tiny", "already exists"),
    (ExitStatus.NOT_POSSIBLE, "open file", "is refused"),
    (ExitStatus.SUCCESS, "verify-run tiny.bundle.zip", "1 to the bit"),
    (ExitStatus.FOUND, "verify-run changed.bundle.zip", "1 differs"),
    (ExitStatus.WRONG_USE, "verify-run nowhere.zip", "there is no such file"),
    (ExitStatus.NOT_POSSIBLE, "verify-run file", "is refused"),
    (ExitStatus.WRONG_USE, "rnu", "Did you mean 'run'?"),
    (ExitStatus.SUCCESS, "--help", "Commands"),
    (ExitStatus.SUCCESS, "run --help", "Usage"),
]  # fmt: skip


def parametrized_rows() -> Iterator[Any]:
    """Every row; those of a command and a status that an earlier one has already are in the slow tier."""
    seen = set()
    for status, words, said in ROWS:
        kind = words.split()[0], status
        yield pytest.param(status, words, said, id=words, marks=pytest.mark.slow if kind in seen else ())
        seen.add(kind)


@pytest.mark.parametrize(("status", "words", "said"), list(parametrized_rows()))
def test_a_row_of_the_table(place: Place, status: ExitStatus, words: str, said: str) -> None:
    done = spelled(place.call(*words.split()))
    assert done.status == status, done.output
    assert said in done.output


def test_every_command_has_a_row_of_success_and_one_of_wrong_use() -> None:
    for name in COMMANDS.keys() - {"reproduce"}:
        for status in (ExitStatus.SUCCESS, ExitStatus.WRONG_USE):
            assert any(words.split()[0] == name and row == status for row, words, _ in ROWS), (name, status)


def test_the_page_has_every_status_and_every_command() -> None:
    table = (DOCS / "commands.md").read_text().split("## Exit statuses")[1].split("\n## ")[0]
    assert {int(number) for number in re.findall(r"^\| (\d+) \|", table, re.MULTILINE)} == set(ExitStatus)
    for name in COMMANDS:
        assert re.search(rf"^\|.*`{name}`.*\|", table, re.MULTILINE), name


@pytest.mark.parametrize("words", ["schema", "list", "table runs/tiny --format csv", "table runs/tiny", "verify raw"])
def test_a_reader_who_stops_reading_is_no_error_to_speak_of(place: Place, words: str) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    command = [str(COMMAND), *words.split()]
    done = subprocess.run(
        command,
        cwd=place.folder,
        env=place.environment(),
        stdout=writing,
        stderr=subprocess.PIPE,
        text=True,
        timeout=60,
    )
    os.close(writing)
    assert (done.returncode, done.stderr) == (ExitStatus.BROKEN_PIPE, "")


def test_a_screen_that_cannot_be_written_is_told(place: Place) -> None:
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [str(COMMAND), "list"], env=place.environment(), stdout=full, stderr=subprocess.PIPE, text=True, timeout=60
        )
    assert done.returncode == ExitStatus.NOT_POSSIBLE
    assert done.stderr.startswith("Error: ")
    assert "No space left on device" in done.stderr
    assert "Traceback" not in done.stderr


SLOW_TO_LOAD = """
import sys, time
def wait(name, *rest):
    if name == "{module}":
        print("waiting", flush=True)
        time.sleep(60)
sys.addaudithook(lambda event, arguments: wait(*arguments) if event == "import" else None)
"""


def test_runs_with_nothing_in_common_are_not_listed(place: Place) -> None:
    done = place.call("compare", "elsewhere.json", "runs/tiny", COLUMNS="60")
    assert done.stdout.splitlines() == ["2 inconclusive"]
    assert done.stderr.splitlines() == [
        "the runs have nothing in common: no sequence with the same",
        "setting, evaluator and metric",
    ]
    assert "not in the first run" in place.call("compare", "elsewhere.json", "runs/tiny", "--all").stdout
    assert len(json.loads(place.call("compare", "elsewhere.json", "runs/tiny", "--format", "json").stdout)["rows"]) == 2


def test_the_most_telling_rows_of_a_comparison_are_shown(place: Place) -> None:
    """Twenty in the terminal, what became worse first and what changed most first; all where asked and for programs."""
    head, line = (place.folder / "base.json").read_text().splitlines()
    for name, values in (("old", [1.0] * 30), ("new", [*range(-9, 20), 1.0])):
        lines = [re.sub(r'"metric": "[^"]*"', f'"metric": "m{at}"', line) for at in range(30)]
        lines = [
            re.sub(r'"values": .[^]]*.', f'"values": [{value}]', text)
            for text, value in zip(lines, values, strict=True)
        ]
        (place.folder / f"{name}.json").write_text("\n".join([head, *lines]) + "\n")
    done = place.call("compare", "old.json", "new.json", COLUMNS="60")
    lines = [text.rstrip() for text in done.stdout.splitlines()]
    assert [line.split() for line in lines[1:21]] == [
        *(["worse", f"error.m{value + 9}", str(value), f"{100 * (value - 1)}"] for value in range(19, 1, -1)),
        *(["better", f"error.m{value + 9}", str(value), f"{100 * (value - 1)}"] for value in (-9, -8)),
    ]
    assert lines[-3:] == [
        "In all rows: sequence ramp, setting shift, before 1.",
        "... and 8 more; --all shows them",
        "18 worse, 10 better, 2 same",
    ]
    assert place.call("compare", "old.json", "new.json", "--format", "markdown").stdout.count("| better |") == 10
    assert place.call("compare", "old.json", "new.json", "--all").stdout.count("\nsame ") == 2


@pytest.mark.parametrize(
    ("words", "module"),
    [
        ("plan tiny.yaml", "codecbench.core.engine.planning.plan"),
        pytest.param("list", "codecbench.core.engine.plugins.registry", marks=pytest.mark.slow),
        pytest.param("schema", "codecbench.core.engine.planning.schema", marks=pytest.mark.slow),
        ("table runs/tiny", "codecbench.core.analysis.collect"),
        pytest.param("report runs/tiny", "codecbench.core.analysis.collect", marks=pytest.mark.slow),
        pytest.param("plot runs/tiny", "codecbench.core.analysis.collect", marks=pytest.mark.slow),
        ("compare runs/tiny runs/tiny", "codecbench.core.analysis.comparison"),
        pytest.param("status runs/tiny", "codecbench.core.engine.storage.store", marks=pytest.mark.slow),
        pytest.param("reproduce runs/tiny", "codecbench.core.analysis.collect", marks=pytest.mark.slow),
        pytest.param("data list", "codecbench.plugins.datasets.catalog", marks=pytest.mark.slow),
        pytest.param("warm-up tiny.yaml", "codecbench.core.engine.planning.plan", marks=pytest.mark.slow),
        ("run tiny.yaml", "codecbench.core.engine.planning.plan"),
        ("verify raw", "codecbench.core.conformance.suite"),
    ],
)
def test_an_interrupted_command_says_so(place: Place, tmp_path: Path, words: str, module: str) -> None:
    (tmp_path / "sitecustomize.py").write_text(SLOW_TO_LOAD.format(module=module))
    path = os.pathsep.join([str(tmp_path), place.environment()["PYTHONPATH"]])
    running = place.start(*words.split(), PYTHONPATH=path)
    assert running.stdout is not None
    assert running.stdout.readline() == "waiting\n"
    os.killpg(running.pid, signal.SIGINT)
    _, said = running.communicate(timeout=30)
    assert (running.returncode, said) == (ExitStatus.INTERRUPTED, "stopped\n")


@pytest.mark.parametrize(
    ("words", "number", "to_all"),
    [
        ("run slow.yaml", signal.SIGINT, False),
        ("run slow.yaml", signal.SIGINT, True),
        ("run slow.yaml", signal.SIGTERM, False),
        ("run slow.yaml", signal.SIGTERM, True),  # as timeout(1) does
        ("choose slow.yaml --link ideal --deadline 10ms", signal.SIGTERM, False),
    ],
)
def test_an_interrupted_run_keeps_what_it_has(
    place: Place, tmp_path: Path, words: str, number: signal.Signals, to_all: bool
) -> None:
    out = tmp_path / "run"
    running = place.start(*words.split(), "--out", str(out))
    deadline = time.monotonic() + 60
    while not (out / "plan.json").exists() and time.monotonic() < deadline:
        time.sleep(0.1)
    time.sleep(1)
    os.killpg(running.pid, number) if to_all else running.send_signal(number)
    printed, said = running.communicate(timeout=60)
    assert running.returncode == ExitStatus.INTERRUPTED
    assert "Traceback" not in printed + said
    assert "crashed" not in printed
    assert f"stopped by {number.name} before a cell had a result; the same command continues from here" in said
    assert place.call("report", str(out)).stderr.startswith(f"Error: {out} has no results yet")


def test_an_interrupted_verify_leaves_no_process(place: Place, tmp_path: Path) -> None:
    running = place.start("verify", "slow", "--only", "bytes")
    assert running.stdout is not None
    assert running.stdout.readline().startswith("slow")
    time.sleep(1)
    os.kill(running.pid, signal.SIGINT)
    _, said = running.communicate(timeout=30)
    assert (running.returncode, said) == (ExitStatus.INTERRUPTED, "stopped\n")
    deadline = time.monotonic() + 10
    while (left := alive(running.pid)) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert left == []


def alive(group: int) -> list[str]:
    """The command lines of the processes of a group."""
    found = []
    for process in psutil.process_iter():
        with suppress(psutil.Error, ProcessLookupError):
            if os.getpgid(process.pid) == group and process.status() != psutil.STATUS_ZOMBIE:
                found.append(" ".join(process.cmdline()))
    return found


FAULTY = """
import codecbench.cli.plan
def fault(*arguments, **named):
    raise ZeroDivisionError("a fault of ours")
codecbench.cli.plan.status.callback = fault
"""


def test_a_fault_of_our_own_is_short_and_its_place_is_kept(place: Place, tmp_path: Path) -> None:
    (tmp_path / "sitecustomize.py").write_text(FAULTY)
    path = os.pathsep.join([str(tmp_path), place.environment()["PYTHONPATH"]])
    done = place.call("status", "runs/tiny", PYTHONPATH=path, TMPDIR=str(tmp_path))
    assert done.status == ExitStatus.FAULT
    first, second = done.stderr.splitlines()
    assert first == "Error in codecbench: ZeroDivisionError: a fault of ours"
    (kept,) = tmp_path.glob("codecbench-fault-*.txt")
    assert str(kept) in second
    assert "in fault" in kept.read_text()
    shown = place.call("status", "runs/tiny", PYTHONPATH=path, TMPDIR=str(tmp_path), CODECBENCH_DEBUG="1")
    assert shown.status == ExitStatus.FAULT
    assert "Traceback" in shown.stderr
    assert len(list(tmp_path.glob("codecbench-fault-*.txt"))) == 1


def test_what_programs_read_is_whole(place: Place) -> None:
    assert json.loads(place.call("status", "runs/tiny", "--json").stdout)["counts"] == {"ok": 1}
