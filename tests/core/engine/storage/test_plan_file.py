"""The plan of a run folder: read back as it was written, refused where it was changed, and sealed by its writer."""

from __future__ import annotations

import json
import logging
from pathlib import Path

import pytest

from codecbench.core.contracts.errors import StoreError
from codecbench.core.engine.planning.model import Plan, PluginSetting, RunSettings
from codecbench.core.engine.storage.plan_file import PlanFile

PLAN = Plan("name", "name: it\n", RunSettings(1, 1.0, 1, 0, PluginSetting("executor", "e", "1")), (), (), ())


@pytest.fixture
def plan_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> PlanFile:
    monkeypatch.setenv("CODECBENCH_CACHE", str(tmp_path / "cache"))
    (tmp_path / "run").mkdir()
    plan_file = PlanFile(tmp_path / "run")
    plan_file.write(PLAN)
    return plan_file


def test_a_plan_is_read_back_as_it_was_written(plan_file: PlanFile) -> None:
    assert plan_file.read() == PLAN
    assert (plan_file.folder / "matrix.yaml").read_text() == PLAN.matrix_text


def test_a_plan_that_was_changed_is_refused_with_what_to_do(plan_file: PlanFile) -> None:
    path = plan_file.folder / "plan.json"
    path.write_text(path.read_text().replace('"name"', '"eman"', 1))
    with pytest.raises(StoreError, match=r"plan\.json is damaged .*checksum"):
        plan_file.read()


def test_a_matrix_that_was_changed_is_reported_and_the_plan_still_read(
    plan_file: PlanFile, caplog: pytest.LogCaptureFixture
) -> None:
    path = plan_file.folder / "matrix.yaml"
    path.write_text("name: other\n")
    with caplog.at_level(logging.WARNING):
        assert plan_file.read() == PLAN
    assert f"{path.name} is missing or" in caplog.text


def test_only_the_key_of_its_writer_proves_where_a_plan_was_made(
    plan_file: PlanFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert plan_file.origin_elsewhere() is None
    content = json.loads((plan_file.folder / "plan.json").read_text())
    monkeypatch.setenv("CODECBENCH_CACHE", str(tmp_path / "another-user"))
    assert str(plan_file.folder) in str(plan_file.origin_elsewhere())
    assert content["origin"]["path"] == str(plan_file.folder)
