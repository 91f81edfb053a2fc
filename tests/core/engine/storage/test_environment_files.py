"""Descriptions of machines: read back as they were written, and told from damaged ones."""

from __future__ import annotations

import json
import logging
import re
from pathlib import Path

import pytest

from codecbench.core.engine.storage.environment import EnvironmentFiles, environment_id

DESCRIPTION = {"machine": {"cpu": "an abacus"}, "packages": {"numpy": "2"}}
NAME = environment_id(DESCRIPTION)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    EnvironmentFiles(tmp_path).write(NAME, DESCRIPTION)
    return tmp_path


def test_a_description_comes_back(folder: Path) -> None:
    files = EnvironmentFiles(folder)
    assert files.read() == {NAME: DESCRIPTION}
    assert files.damaged() == {}


def test_a_damaged_one_is_left_out_with_a_line_in_the_log_and_written_again(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = folder / f"{NAME}.json"
    path.write_text(path.read_text().replace("abacus", "engine"))
    with caplog.at_level(logging.WARNING):
        assert EnvironmentFiles(folder).read() == {}
    (message,) = caplog.messages
    assert re.match(rf"{path} is damaged \(.*checksum", message)
    EnvironmentFiles(folder).write(NAME, DESCRIPTION)
    assert EnvironmentFiles(folder).read() == {NAME: DESCRIPTION}


def test_a_sound_one_is_not_written_again(folder: Path) -> None:
    before = (folder / f"{NAME}.json").stat().st_mtime_ns
    EnvironmentFiles(folder).write(NAME, DESCRIPTION)
    assert (folder / f"{NAME}.json").stat().st_mtime_ns == before


def test_the_description_of_another_environment_is_damage(folder: Path) -> None:
    (folder / "other.json").write_bytes((folder / f"{NAME}.json").read_bytes())
    assert EnvironmentFiles(folder).damaged() == {"other": f"it describes environment {NAME}"}


def test_those_of_earlier_versions_have_no_checksum_and_are_checked_by_their_name(tmp_path: Path) -> None:
    (tmp_path / f"{NAME}.json").write_text(json.dumps(DESCRIPTION))
    (tmp_path / "other.json").write_text(json.dumps(DESCRIPTION))
    files = EnvironmentFiles(tmp_path)
    assert files.read() == {NAME: DESCRIPTION}
    damaged = files.damaged()
    assert list(damaged) == ["other"]
    assert "match its name" in damaged["other"]


@pytest.mark.parametrize("content", ["[]", '"text"', "not JSON"])
def test_what_is_no_description_is_damage(tmp_path: Path, content: str) -> None:
    (tmp_path / "x.json").write_text(content)
    assert EnvironmentFiles(tmp_path).damaged().keys() == {"x"}
