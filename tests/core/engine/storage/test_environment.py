"""The description of where a result was computed."""

from __future__ import annotations

import hashlib
import json
import platform
import subprocess
import sys
from importlib.metadata import version

import numpy as np
import pytest
from project import ROOT

from codecbench.core.engine.storage import environment
from codecbench.core.engine.storage.environment import describe_environment, environment_id


@pytest.fixture(scope="module")
def described() -> dict:  # type: ignore[type-arg]
    return describe_environment()


def test_it_names_what_can_change_a_result(described: dict) -> None:  # type: ignore[type-arg]
    assert described["python"]["version"] == platform.python_version()
    assert described["distributions"]["numpy"] == np.__version__
    assert described["distributions"]["codecbench"] == version("codecbench")
    assert "turbo" in described["libraries"]["opencv JPEG"]
    assert any(one.startswith("codecbench ") for one in described["plugins"])
    assert described["machine"]["cores"] >= 1
    assert json.loads(json.dumps(described)) == described


def test_its_id_is_the_same_in_another_process(described: dict) -> None:  # type: ignore[type-arg]
    code = """
from codecbench.core.engine.storage.environment import describe_environment, environment_id
from codecbench.core.engine.plugins.registry import installed
print(environment_id(describe_environment()))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout.strip() == environment_id(described)
    assert environment_id(dict(reversed(described.items()))) == environment_id(described)


def test_its_id_is_the_digest_of_what_is_not_volatile() -> None:
    known = {"python": {"version": "3.11.2"}, "checkout": None, "volatile": {"host": "here"}}
    text = b'{"checkout":null,"python":{"version":"3.11.2"}}'
    assert environment_id(known) == hashlib.blake2b(text, digest_size=16).hexdigest()[:16]
    assert environment_id({**known, "volatile": {"host": "elsewhere", "governor": "powersave"}}) == environment_id(
        known
    )


def changed(value: object) -> object:
    """A value of the same kind that differs from `value` in one leaf."""
    if isinstance(value, dict) and value:
        name = sorted(value)[-1]
        return {**value, name: changed(value[name])}
    if isinstance(value, list) and value:
        return [*value[:-1], changed(value[-1])]
    if isinstance(value, bool):
        return not value
    return value + 1 if isinstance(value, int) else f"{value} changed"


@pytest.mark.parametrize(
    "part", ["machine", "system", "python", "distributions", "libraries", "plugins", "threads", "checkout"]
)
def test_every_part_enters_its_id_down_to_the_last_leaf(described: dict, part: str) -> None:  # type: ignore[type-arg]
    assert set(described) - {"volatile"} == {
        *("machine", "system", "python", "distributions", "libraries", "plugins", "threads", "checkout")
    }
    assert environment_id({**described, part: changed(described[part])}) != environment_id(described)
    assert environment_id({name: value for name, value in described.items() if name != part}) != environment_id(
        described
    )


def test_a_machine_that_tells_nothing_is_described_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(environment, "_text", lambda path: None)
    monkeypatch.setattr(environment, "_git", lambda *_: None)
    described = describe_environment()
    assert described["machine"]["memory_mb"] is None
    assert environment_id(described) == environment_id(describe_environment())
    assert environment_id({**described, "checkout": {"commit": "abc", "changed": False}}) != environment_id(described)


def test_a_checkout_has_its_commit() -> None:
    command = ["git", "-C", str(ROOT), "rev-parse", "HEAD"]
    process = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    checkout = environment.describe_environment()["checkout"]
    assert (checkout and checkout["commit"]) == (process.stdout.strip() or None)
