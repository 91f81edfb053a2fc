"""What docs/citing.md shows comes out so, and docs/gallery.py makes its page from bundles alone."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from installed_command import Place
from kept_runs import write_kept_run
from project import DOCS

import codecbench
from codecbench.core.engine.bundling import container, manifest

PAGE = (DOCS / "citing.md").read_text()


def test_the_numbers_of_the_page_are_those_of_the_code() -> None:
    assert f"more than {manifest.MOST_FILES:,} files" in PAGE
    assert f"more than {manifest.LARGEST_FILE // 10**6} MB" in PAGE
    assert f"one sequence: {manifest.LARGEST_BITSTREAMS // 10**9} GB" in PAGE
    assert f"more than {container._MOST_RATIO} times its size and {container._SLACK // 10**6} MB" in PAGE


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


@pytest.mark.thorough
def test_the_gallery_is_made_from_bundles(tmp_path: Path) -> None:
    write_kept_run(tmp_path / "run", sequence="<img src=x onerror=alert(1)>", note="[a](http://b)")
    path = codecbench.bundle(tmp_path / "run")
    shutil.copy(DOCS / "gallery.py", tmp_path)
    command = [sys.executable, str(tmp_path / "gallery.py"), str(path)]
    subprocess.run(command, check=True, timeout=120)
    page = (tmp_path / "gallery.md").read_text()
    assert "<img" not in page
    assert "| what was run | 1 settings of 1 codecs: shifts |" in page
    assert f"run.bundle.zip, {path.stat().st_size:,} bytes" in page
    assert "| report | [run.html](gallery/run.html) |" in page
    report = (tmp_path / "gallery" / "run.html").read_text()
    assert "shifts" in report
    assert "<img src=x" not in report
    assert subprocess.run([*command, "--check"], timeout=120).returncode == 0
    (tmp_path / "gallery.md").write_text(page.replace("shifts", "shafts"))
    assert subprocess.run([*command, "--check"], timeout=120).returncode == 1


def test_the_reports_of_the_gallery_name_no_folder_of_the_machine_they_were_made_on() -> None:
    reports = sorted((DOCS / "gallery").glob("*.html"))
    linked = re.findall(r"\(gallery/(\w+)\.html\)", (DOCS / "gallery.md").read_text())
    assert [path.stem for path in reports] == sorted(linked)
    for path in reports:
        html = path.read_text()
        assert len(html) < 1_000_000
        assert not re.search(r"/(?:home|root|tmp|opt|work|mnt|srv)/\w", html)
