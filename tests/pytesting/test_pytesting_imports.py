"""What `codecbench.pytesting` costs whoever has codecbench installed, and where its parts are found."""

from __future__ import annotations

import subprocess
import sys

import pytest

import codecbench.pytesting
from codecbench.pytesting.suite import CodecSuite


def _run(code: str, *options: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, *options, "-c", code], capture_output=True, text=True, check=False)


def test_every_pytest_run_loads_the_plugin_and_nothing_heavy() -> None:
    code = "import sys, pytest; before = set(sys.modules); import codecbench.pytesting.plugin\n"
    done = _run(code + "print(*sorted({name.partition('.')[0] for name in set(sys.modules) - before}))")
    assert done.returncode == 0, done.stderr
    assert "codecbench" in done.stdout.split()
    assert set(done.stdout.split()) - {"codecbench"} <= set(sys.stdlib_module_names)


def test_the_suite_is_found_where_the_documentation_says() -> None:
    assert codecbench.pytesting.CodecSuite is CodecSuite
    with pytest.raises(AttributeError, match="'CodecSweet'"):
        _ = codecbench.pytesting.CodecSweet
