"""Kernels as objects: builds, caches, what they refuse."""

from __future__ import annotations

import copy
import os
import pickle
import subprocess
import sys
import textwrap
from itertools import count
from pathlib import Path

import instrument_kernels as examples
import numba
import numpy as np
import pytest

from codecbench.core.counting.kernel import Kernel, UncountableError, kernel, new_counters
from codecbench.core.kernels.source import SourceError


def test_a_kernel_pickles_by_reference_and_keeps_its_name() -> None:
    assert pickle.loads(pickle.dumps(examples.divided)) is examples.divided
    assert copy.deepcopy(examples.divided) is examples.divided
    assert examples.divided.__doc__ == "Two results."
    assert examples.divided.python(17, 5) == (3, 2)
    assert repr(examples.divided) == "<kernel instrument_kernels.divided>"


def test_kernels_are_called_from_plain_numba_functions() -> None:
    @numba.njit
    def caller(value: int) -> int:
        return examples.clamped(value, 0, 3) + 1

    assert caller(9) == 4


def test_options_reach_both_builds() -> None:
    @kernel(error_model="numpy")
    def ratio(a, b):  # type: ignore[no-untyped-def]
        return a / b

    assert ratio(1.0, 0.0) == float("inf")
    counters = new_counters()
    assert ratio.counting_build(counters, 1.0, 0.0) == float("inf")
    with pytest.raises(ZeroDivisionError):
        examples.divided(1, 0)


numbers = count()


def uncountable(body: str, folder: Path) -> str:
    """The message with which the counting build of a kernel with this body is refused."""
    name = f"refused_{next(numbers)}"
    lines = textwrap.indent(textwrap.dedent(body).strip(), "    ")
    (folder / f"{name}.py").write_text(
        "import math\nimport numpy as np\nfrom codecbench.core.counting.kernel import kernel\n"
        f"PAIR = (1, 2)\ndef plain(x):\n    return x\n\n\n@kernel\ndef refused(a, b):\n{lines}\n"
    )
    refused: Kernel = __import__(name).refused
    with pytest.raises(UncountableError) as caught:
        refused.counting_build(new_counters(), np.ones((3, 3)), np.arange(3))
    assert f"{name}.py:" in str(caught.value)
    assert "kernel refused" in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("return [x for x in b]", "uses '[x for x in b]'"),
        ("return sum(b)", "calls 'sum', "),
        ("return np.sum(b)", "calls 'np.sum'"),
        ("return b.sum()", "calls 'b.sum'"),
        ("return plain(b[0])", "calls 'plain'"),
        ("for x in b:\n    pass", "loops over 'b'"),
        ("for i, x in enumerate(b):\n    pass", "loops over 'enumerate(b)'"),
        ("return b[0] ** 2", "operator Pow"),
        ("return a @ a", "operator MatMult"),
        ("return b[0] in PAIR", "operator In"),
        ("return (x := b[0]) + 1", "uses '(x := b[0])'"),
        ("return lambda: 1", "uses 'lambda: 1'"),
        ("with a:\n    pass", "uses 'with a:'"),
        ("try:\n    return 1\nexcept ValueError:\n    return 2", "uses 'try:'"),
        ("assert b[0] > 0", "uses 'assert b[0] > 0'"),
        ("return 'text'", "uses the constant 'text'"),
        ("return a.T", "uses 'a.T'"),
        ("return a[0][1]", "indexes 'a[0]'"),
        ("b.shape = 3", "assigns to 'b.shape'"),
        ("return max(*b)", "calls 'max'"),
        ("return abs(*b)", "passes * or ** arguments"),
        ("return np.zeros(3)[1]", "indexes 'np.zeros(3)'"),
        ("return min(np.zeros(3)[0], 1)", "indexes"),
        ("return len(np.zeros(3))", "uses 'np.zeros' inside a statement"),
        ("counting__adds = 1\nreturn counting__adds", "uses the name counting__adds"),
        ("a[:] += 1", "assigns to 'a[:]'"),
        ("return a * 2", "arithmetic on whole arrays"),
        ("c = -b\nreturn c", "arithmetic on whole arrays"),
        ("c = b < 2\nreturn c", "arithmetic on whole arrays"),
        ("return np.floor(b)", "whole arrays"),
        ("return a[1]", "one index too few"),
        ("a[1] = 0", "stores a whole array"),
        ("a[1, :] = b", "stores a whole array"),
        ("return b[b]", "one index too few"),
        ("return PAIR[b[0]]", "other than an array"),
        ("c = (b[0], b[1])\nreturn c[1]", "other than an array"),
    ],
)
def test_what_cannot_be_counted_is_refused_with_its_line(
    body: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    assert message in uncountable(body, tmp_path)


def test_closures_and_builtins_are_refused() -> None:
    outside = 3

    @kernel
    def closing(x):  # type: ignore[no-untyped-def]
        return x + outside

    with pytest.raises(SourceError, match="closes over outside"):
        closing.counting_build(new_counters(), 1)
    assert closing(1) == 4
    with pytest.raises(TypeError, match="plain function"):
        kernel(len)


CALLEE = """
from codecbench.core.counting.kernel import kernel

@kernel
def inner(x):
    return x + 1
"""
CALLER = """
import sys
import numpy as np
from callee import inner
import constants
from codecbench.core.counting.kernel import kernel, new_counters

@kernel
def outer(x):
    return inner(x) * constants.FACTOR + constants.TABLE[1]

counters = new_counters()
print(outer(5), outer.counting_build(counters, 5), *counters[:2], *(sum(one.fast.stats.cache_hits.values()) for one in (outer,)))
"""  # noqa: E501
CONSTANTS = "import numpy as np\nFACTOR = 10\nTABLE = np.array([1, 2])\n"


def ran(folder: Path, cache: Path) -> list[int]:
    places = {"CODECBENCH_CACHE": str(cache), "XDG_CACHE_HOME": str(cache)}
    environment = {**os.environ, **places, "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "caller.py"]
    output = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=True)
    return [int(word) for word in output.stdout.split()]


@pytest.mark.thorough
def test_an_edit_in_another_file_is_never_ignored(tmp_path: Path) -> None:
    project, cache = tmp_path / "project", tmp_path / "cache"
    project.mkdir()
    for name, text in (("callee", CALLEE), ("caller", CALLER), ("constants", CONSTANTS)):
        (project / f"{name}.py").write_text(text)
    assert ran(project, cache) == [62, 62, 1, 2, 0]
    assert ran(project, cache) == [62, 62, 1, 2, 1], "the second process finds what the first compiled"
    (project / "callee.py").write_text(CALLEE.replace("x + 1", "x * 3"))
    assert ran(project, cache) == [152, 152, 2, 1, 0]
    (project / "constants.py").write_text(CONSTANTS.replace("[1, 2]", "[1, 4]"))
    assert ran(project, cache) == [154, 154, 2, 1, 0]
    (project / "callee.py").write_text("# a comment moves the lines\n" + CALLEE.replace("x + 1", "x * 3"))
    assert ran(project, cache) == [154, 154, 2, 1, 1], "what changes no code compiles nothing"
    for file in cache.rglob("*.bin"):
        file.write_bytes(file.read_bytes()[:-9])
    assert ran(project, cache) == [154, 154, 2, 1, 0], "damaged entries are compiled anew"


def test_a_cache_that_cannot_be_written_costs_only_time(tmp_path: Path) -> None:
    for name, text in (("callee", CALLEE), ("caller", CALLER), ("constants", CONSTANTS)):
        (tmp_path / f"{name}.py").write_text(text)
    blocked = tmp_path / "file"
    blocked.write_text("no folder")
    assert ran(tmp_path, blocked) == [62, 62, 1, 2, 0]


def test_a_file_edited_after_its_import_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "edited.py").write_text(CALLEE)
    inner: Kernel = __import__("edited").inner
    (tmp_path / "edited.py").write_text(CALLEE.replace("x + 1", "x + 2"))
    with pytest.raises(SourceError, match=r"edited\.py:\d+: .* inner"):
        inner.counting_build(new_counters(), 1)
    assert inner(1) == 2
