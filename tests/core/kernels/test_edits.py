"""No edit of what a compiled kernel depends on is ever missed, in whichever file it stands; nothing is ever cleared."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import codecbench

PACKAGE = {
    "__init__.py": "",
    "thresholds.py": "LIMIT = 10\nGAINS = (2, 3)\n",
    "bits.py": """
from numba import types
from numba.extending import intrinsic

@intrinsic
def doubled(context, value):
    def generate(context, builder, signature, arguments):
        return builder.mul(arguments[0], context.get_constant(types.int64, 2))
    return types.int64(types.int64), generate
""",
    "kernels.py": """
from codecbench.core.kernels.compiled import compiled
from edited import thresholds
from edited.bits import doubled

@compiled
def clipped(value):
    '''At most the limit.'''
    return doubled(value) if value < thresholds.LIMIT else thresholds.LIMIT
""",
    "caller.py": """
from codecbench.core.kernels.compiled import compiled
from edited.kernels import clipped
from edited.thresholds import GAINS

@compiled
def called(value):
    return clipped(value) * GAINS[0] + GAINS[1]
""",
}
PROGRAM = """
from edited.caller import called
print(called(4), called(50), *called.stats.cache_hits.values(), len(called.stats.cache_misses))
"""


class Project:
    """A package of five files, used by a process of its own each time."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.package = folder, folder / "edited"
        self.package.mkdir()
        for name, text in PACKAGE.items():
            (self.package / name).write_text(text)

    def edit(self, name: str, old: str, new: str) -> None:
        text = (self.package / name).read_text()
        assert old in text
        (self.package / name).write_text(text.replace(old, new))

    def run(self) -> tuple[list[int], bool]:
        """What `called` returns for 4 and 50, and whether its code was found on disk."""
        environment = {**os.environ, "CODECBENCH_CACHE": str(self.folder / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
        command = [sys.executable, "-c", PROGRAM]
        done = subprocess.run(command, cwd=self.folder, env=environment, capture_output=True, text=True, check=True)
        words = done.stdout.split()
        return [int(word) for word in words[:2]], words[2:] == ["1", "0"]


@pytest.fixture(scope="module")
def warm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project whose kernels have been compiled."""
    project = Project(tmp_path_factory.mktemp("edits"))
    assert project.run() == ([19, 23], False)
    assert project.run() == ([19, 23], True), "the second process finds what the first compiled"
    return project.folder


@pytest.fixture
def project(warm: Path, tmp_path: Path) -> Project:
    made = Project(tmp_path)
    shutil.copytree(warm / "cache", tmp_path / "cache")
    return made


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("file", "old", "new", "result"),
    [
        ("thresholds.py", "LIMIT = 10", "LIMIT = 20", [19, 43]),
        ("thresholds.py", "(2, 3)", "(2, 4)", [20, 24]),
        ("kernels.py", "else thresholds.LIMIT", "else -thresholds.LIMIT", [19, -17]),
        ("bits.py", "types.int64, 2)", "types.int64, 3)", [27, 23]),
        ("caller.py", "+ GAINS[1]", "- GAINS[1]", [13, 17]),
    ],
    ids=["a threshold", "a tuple of constants", "a helper elsewhere", "an intrinsic", "the kernel"],
)
def test_an_edit_is_seen(project: Project, file: str, old: str, new: str, result: list[int]) -> None:
    project.edit(file, old, new)
    assert project.run() == (result, False)
    project.edit(file, new, old)
    assert project.run() == ([19, 23], True), "what was compiled before the edit is still there"


@pytest.mark.thorough
def test_an_edit_that_changes_no_code_compiles_nothing(project: Project) -> None:
    project.edit("kernels.py", "'''At most the limit.'''", "'''Never more than the limit.'''\n    # by design\n")
    project.edit("thresholds.py", "LIMIT = 10", "UNUSED = 1\nLIMIT = 10")
    assert project.run() == ([19, 23], True)


SLAM = """
import numpy as np
from codecbench.slam.optimization.pose_optimization import optimize_pose
points = np.array([[x, y, 5.0 + x * y] for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)])
pixels = points[:, :2] / points[:, 2:] * 500.0 + [320.0, 240.0]
pixels[:, 0] += [2.0, -2.0, 2.0, -2.0, 0.0, -2.0, 2.0, -2.0, 2.0]
pose, inliers = optimize_pose(np.eye(4), points, pixels, np.ones(9), np.array([500.0, 500.0, 320.0, 240.0]))
print(int(inliers.sum()))
"""


@pytest.mark.thorough
def test_an_edited_threshold_of_the_slam_is_seen(tmp_path: Path) -> None:
    site = tmp_path / "site"
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(Path(codecbench.__file__).parent, site / "codecbench", ignore=ignored)

    def inliers() -> int:
        environment = {**os.environ, "CODECBENCH_CACHE": str(tmp_path / "cache"), "PYTHONPATH": str(site)}
        command = [sys.executable, "-c", SLAM]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
        return int(done.stdout)

    assert inliers() == 9
    thresholds = site / "codecbench" / "slam" / "thresholds.py"
    text = thresholds.read_text()
    assert "CHI2_95_2DOF: Final = 5.991" in text
    thresholds.write_text(text.replace("CHI2_95_2DOF: Final = 5.991", "CHI2_95_2DOF: Final = 0.991"))
    assert inliers() < 9
