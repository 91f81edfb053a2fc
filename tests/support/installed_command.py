"""The command in a process of its own, and the place that it works in."""

from __future__ import annotations

import os
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from distributions import register
from project import SUPPORT
from warm_command import COMMAND, run_warm

TINY = """
version: 1
name: tiny
sequences: [{use: ramp, params: {frames: 4}}]
codecs: [shift]
evaluators: [error]
run: {workers: 1}
"""
"""A matrix of one quick cell, of the plugins in `plain_plugins`."""


@dataclass(frozen=True)
class Place:
    """A folder to work in, with plugin distributions of its own in the folder `site`."""

    folder: Path

    @property
    def site(self) -> Path:
        path = self.folder / "site"
        path.mkdir(exist_ok=True)
        return path

    def environment(self, **variables: str) -> dict[str, str]:
        paths = os.pathsep.join([str(self.site), str(Path(__file__).parent)])
        return {**os.environ, "PYTHONPATH": paths, "COLUMNS": "200", **variables}

    def call(self, *words: str, timeout: float = 300, most_bytes: int | None = None, **variables: str) -> Done:
        """Run `codecbench WORDS`. most_bytes: limit of the size of files."""
        done = run_warm([*words], self.folder, self.environment(**variables), timeout, most_bytes)
        return Done(done.returncode, done.stdout, done.stderr)

    def start(self, *words: str, **variables: str) -> subprocess.Popen[str]:
        """Begin `codecbench WORDS`, as the first of a session of its own."""
        pipe = subprocess.PIPE
        return subprocess.Popen(
            [str(COMMAND), *words], cwd=self.folder, env=self.environment(**variables), stdout=pipe, stderr=pipe,
            text=True, start_new_session=True,
        )  # fmt: skip


def plain_place(folder: Path) -> Place:
    """A place with the plain plugins."""
    place = Place(folder)
    shutil.copy(SUPPORT / "plain_plugins.py", place.site)
    register(place.site, "plain", "1", "plain_plugins")
    return place


def tiny_place(folder: Path) -> Place:
    """A place with the plain plugins, and the matrix `tiny.yaml` with its finished run in `runs/tiny`."""
    place = plain_place(folder)
    (folder / "tiny.yaml").write_text(TINY)
    done = place.call("run", "tiny.yaml")
    assert done.status == 0, done.output
    return place


@dataclass(frozen=True)
class Done:
    """How a command ended."""

    status: int
    stdout: str
    stderr: str

    @property
    def output(self) -> str:
        return self.stdout + self.stderr
