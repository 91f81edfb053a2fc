"""What docs/slam.md shows is what happens."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from rendered_scenes import CAMERA, Room, path_pose

import codecbench.slam
from codecbench.slam import Options, System
from codecbench.slam.tracking import keyframe_policy

pytestmark = pytest.mark.thorough

PAGE = (Path(__file__).parents[2] / "docs" / "slam.md").read_text()
USE, POLICY = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
STEP_S = 1.0 / 15.0


@pytest.fixture(scope="module")
def film() -> list[NDArray[np.uint8]]:
    room = Room()
    return [room.image(path_pose(i)) for i in range(45)]


def keyframe_gaps_s(film: list[NDArray[np.uint8]]) -> NDArray[np.float64]:
    """Seconds between keyframes, from the frame that started the map on."""
    system = System(CAMERA, Options(features=600), seed=1)
    states = [system.process(image, STEP_S * i) for i, image in enumerate(film)]
    first = [state.state for state in states].index("tracked")
    assert all(state.state == "tracked" for state in states[first:])
    return np.diff([state.timestamp_s for state in states if state.keyframe])


def test_the_use_that_is_shown_runs(capsys: pytest.CaptureFixture[str]) -> None:
    frames = [(0.1 * i, np.full((480, 640, 3), 90, np.uint8)) for i in range(3)]
    names: dict[str, object] = {"frames": frames}
    exec(USE, names)
    assert capsys.readouterr().out == "0 poses, 0 loops\n"


def test_the_policy_that_is_shown_decides(film: list[NDArray[np.uint8]], monkeypatch: pytest.MonkeyPatch) -> None:
    usual = keyframe_gaps_s(film)
    names: dict[str, object] = {}
    exec(POLICY, names)
    monkeypatch.setattr(keyframe_policy, "wants_keyframe", names["wants_keyframe"])
    gaps = keyframe_gaps_s(film)
    assert gaps.min() > 0.399
    assert gaps.max() < 0.4 + STEP_S + 0.001
    assert usual.min() < 0.3


def test_every_public_name_is_named() -> None:
    for name in codecbench.slam.__all__:
        assert f"`{name}`" in PAGE


def test_every_room_is_in_the_table() -> None:
    package = Path(codecbench.slam.__file__).parent
    rooms = {path.name + "/" for path in package.iterdir() if (path / "__init__.py").exists()}
    rooms |= {path.name for path in package.glob("*.py")} - {"__init__.py"}
    table = "\n".join(line.split("|")[1] for line in PAGE.splitlines() if line.startswith("| `"))
    assert rooms <= set(re.findall(r"`([a-z_]+(?:/|\.py))`", table))
    for file in re.findall(r"`([a-z_/]+\.py)`", PAGE):
        assert (
            list(package.glob(f"**/{file}"))
            or (package.parents[1] / file).exists()
            or any((package.parents[1] / "tests" / "support").glob(file))
        ), file
