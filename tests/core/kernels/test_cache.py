"""One process compiles a kernel; whoever wants it meanwhile waits and takes it from the disk."""

from __future__ import annotations

import fcntl
import os
import platform
import subprocess
import sys
import time
from pathlib import Path

import pytest
from llvmlite import binding

from codecbench.core.kernels.compiled import LEVELS, level_of

KERNELS = """
from codecbench.core.kernels.compiled import compiled

@compiled
def plus(a, b):
    return a + b

@compiled
def factorial(n):
    return 1 if n < 2 else n * factorial(n - 1)

@compiled
def raised(n):
    return plus(n, 1) + plus(n, 2) + plus(n, n)
"""
PLUS = """
from locked import plus

compiled = []
compiler = plus._compiler._compiler
class Noting:
    def __getattr__(self, name):
        return getattr(compiler, name)
    def compile(self, *arguments):
        compiled.append(arguments)
        return compiler.compile(*arguments)
plus._compiler._compiler = Noting()
print(plus(1, 2), len(compiled))
"""
PAIRS = """
from codecbench.core.kernels.compiled import compiled
from %s import Pair

@compiled
def first_of(pair):
    return pair.first
"""
PAIR = """
from typing import NamedTuple

class Pair(NamedTuple):
    %s: int
    %s: int
"""


def start(folder: Path, program: str) -> subprocess.Popen[str]:
    if not (folder / "locked.py").exists():  # another process may be reading it
        (folder / "locked.py").write_text(KERNELS)
    environment = {**os.environ, "CODECBENCH_CACHE": str(folder / "cache")}
    return subprocess.Popen(
        [sys.executable, "-c", program], cwd=folder, env=environment, stdout=subprocess.PIPE, text=True
    )


def output(process: subprocess.Popen[str]) -> str:
    out, _ = process.communicate(timeout=300)
    assert process.returncode == 0
    return out.strip()


@pytest.mark.thorough
def test_processes_that_come_together_compile_once(tmp_path: Path) -> None:
    together = [start(tmp_path, PLUS) for _ in range(3)]
    assert sorted(output(process) for process in together) == ["3 0", "3 0", "3 1"]


@pytest.mark.thorough
def test_who_finds_the_lock_held_waits_for_it(tmp_path: Path) -> None:
    assert output(start(tmp_path, PLUS)) == "3 1"
    (kept,) = (tmp_path / "cache" / "kernels").glob("*.bin")
    content = kept.read_bytes()
    kept.unlink()
    with open(kept.with_suffix(".lock"), "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        waiting = start(tmp_path, PLUS)
        time.sleep(3.0)
        assert waiting.poll() is None
        kept.write_bytes(content)
    assert output(waiting) == "3 0"


@pytest.mark.thorough
def test_a_lock_left_by_a_process_that_died_holds_nobody_up(tmp_path: Path) -> None:
    assert output(start(tmp_path, PLUS)) == "3 1"
    (kept,) = (tmp_path / "cache" / "kernels").glob("*.bin")
    kept.unlink()
    kept.with_suffix(".lock").write_text("")
    assert output(start(tmp_path, PLUS)) == "3 1"


def test_a_processor_has_the_newest_level_whose_features_it_has() -> None:
    older = dict.fromkeys(LEVELS["x86-64-v2"], True)
    newer = {**older, **dict.fromkeys(LEVELS["x86-64-v3"], True)}
    assert level_of(newer) == "x86-64-v3"
    assert level_of({**newer, "fma": False}) == "x86-64-v2"
    assert level_of({**newer, "popcnt": False}) is None


TARGET = """
from numba.core.registry import cpu_target
import locked
print(*cpu_target.target_context.codegen().magic_tuple()[1:])
"""


@pytest.mark.skipif(platform.machine() != "x86_64", reason="other architectures have no such levels")
@pytest.mark.parametrize("chosen", ["", "x86-64"])
def test_kernels_are_compiled_for_a_level_or_for_what_the_user_says(
    chosen: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("NUMBA_CPU_NAME", raising=False)
    monkeypatch.delenv("NUMBA_CPU_FEATURES", raising=False)
    if chosen:
        monkeypatch.setenv("NUMBA_CPU_NAME", chosen)
        monkeypatch.setenv("NUMBA_CPU_FEATURES", "")
    expected = chosen or level_of(binding.get_host_cpu_features())
    assert output(start(tmp_path, TARGET)) == expected


@pytest.mark.thorough
def test_a_kernel_may_call_itself_and_constants_in_a_call_cost_no_signature_of_their_own(tmp_path: Path) -> None:
    program = (
        "from locked import factorial, plus, raised; "
        "print(factorial(5), raised(5), len(raised.signatures), len(plus.signatures))"
    )
    assert output(start(tmp_path, program)) == "120 23 1 1"


@pytest.mark.thorough
def test_a_named_tuple_is_known_by_its_module_and_its_fields(tmp_path: Path) -> None:
    environment = {**os.environ, "CODECBENCH_CACHE": str(tmp_path / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
    for home, fields, expected in (
        ("here", ("first", "second"), "1"),
        ("here", ("second", "first"), "2"),
        ("there", ("second", "first"), "2"),
    ):
        (tmp_path / "here.py").unlink(missing_ok=True)
        (tmp_path / f"{home}.py").write_text(PAIR % fields)
        (tmp_path / "pairs.py").write_text(PAIRS % home)
        command = [sys.executable, "-c", "from pairs import Pair, first_of; print(first_of(Pair(1, 2)))"]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=120)
        assert done.stdout.strip() == expected, done.stderr


def test_what_is_kept_can_be_read_by_all_and_written_by_its_owner_alone(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        assert output(start(tmp_path, PLUS)) == "3 1"
    finally:
        os.umask(before)
    folder = tmp_path / "cache" / "kernels"
    assert oct(folder.stat().st_mode & 0o7777) == "0o755"
    assert {oct(path.stat().st_mode & 0o7777) for path in folder.glob("*.bin")} == {"0o644"}
