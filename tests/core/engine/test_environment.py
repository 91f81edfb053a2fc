"""The description of where a result was computed."""

from __future__ import annotations

import json
import platform
from importlib.metadata import version

import numpy as np
import pytest

from codecbench.core.engine import environment
from codecbench.core.engine.environment import describe_environment, environment_id
from codecbench.core.engine.registry import installed


@pytest.fixture(scope="module")
def described() -> dict:  # type: ignore[type-arg]
    return describe_environment(installed())


def test_it_names_what_can_change_a_result(described: dict) -> None:  # type: ignore[type-arg]
    assert described["python"]["version"] == platform.python_version()
    assert described["distributions"]["numpy"] == np.__version__
    assert described["distributions"]["codecbench"] == version("codecbench")
    assert "turbo" in described["libraries"]["opencv JPEG"]
    assert any(one.startswith("codecbench ") for one in described["plugins"])
    assert described["machine"]["cores"] >= 1
    assert json.loads(json.dumps(described)) == described


def test_its_id_ignores_what_changes_by_itself_and_nothing_else(described: dict) -> None:  # type: ignore[type-arg]
    first = environment_id(described)
    assert environment_id({**described, "volatile": {"host": "elsewhere"}}) == first
    assert environment_id(describe_environment(installed())) == first
    assert environment_id({**described, "threads": {"OMP_NUM_THREADS": "64"}}) != first


def test_a_machine_that_tells_nothing_is_described_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(environment, "_text", lambda path: None)
    monkeypatch.setattr(environment, "_git", lambda *_: None)
    described = describe_environment(installed())
    assert described["machine"]["memory_mb"] is None
    assert environment_id(described)
