"""What docs/citing.md shows comes out so."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
from installed_command import Place
from project import DOCS

import codecbench
from codecbench.core.engine.bundling import container

PAGE = (DOCS / "citing.md").read_text()


def test_the_numbers_of_the_page_are_those_of_the_code() -> None:
    assert f"more than {container.MOST_FILES:,} files" in PAGE
    assert f"more than {container.LARGEST_FILE // 10**6} MB" in PAGE
    assert f"one sequence: {container.LARGEST_BITSTREAMS // 10**9} GB" in PAGE
    assert re.search(rf"more than {container._MOST_RATIO} times .* {container._SLACK // 10**6} MB", PAGE)


@pytest.mark.thorough
def test_the_commands_of_the_page_do_what_it_says(tmp_path: Path) -> None:
    (matrix,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    (commands,) = re.findall(r"```bash\n(.*?)```", PAGE, re.DOTALL)
    (printed,) = re.findall(r"ends with\n\n```\n(.*?)```", PAGE, re.DOTALL)
    (tmp_path / "small.yaml").write_text(matrix)
    place = Place(tmp_path)
    for line in commands.splitlines():
        done = place.call(*line.split()[1:])
        assert done.status == 0, done.output
    assert done.stdout.endswith(printed)
    assert (tmp_path / "runs" / "small.bundle" / "report" / "report.html").exists()
    shutil.rmtree(tmp_path / "runs" / "small.bundle")
    found = codecbench.open_bundle(tmp_path / "runs" / "small.bundle.zip")
    assert len(found.results) == 6
