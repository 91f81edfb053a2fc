"""A small run to export."""

from __future__ import annotations

from pathlib import Path

import cv2
import pytest
from click.testing import CliRunner
from exported_run import MATRIX, STAMPS, frames

from codecbench.cli import cli


@pytest.fixture(scope="package")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run on six gray frames in TUM's format with true poses, one of them before the first frame."""
    folder = tmp_path_factory.mktemp("glide")
    (folder / "rgb").mkdir()
    for stamp, image in zip(STAMPS, frames(), strict=True):
        cv2.imwrite(str(folder / "rgb" / f"{stamp}.png"), image)
    (folder / "rgb.txt").write_text("".join(f"{stamp} rgb/{stamp}.png\n" for stamp in STAMPS))
    poses = [f"{stamp} {place} 2 3 0 0 0.6 0.8\n" for place, stamp in enumerate(["1305031101.500000", *STAMPS])]
    (folder / "groundtruth.txt").write_text("".join(poses))
    (folder / "glide.yaml").write_text(MATRIX.format(path=folder))
    done = CliRunner().invoke(cli, ["run", str(folder / "glide.yaml"), "--out", str(folder / "run")])
    assert done.exit_code == 0, done.output
    return folder / "run"
