"""Localization: a filmed room whose frames are located in a map of itself, and answers made by hand."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from memory_sequence import CodedInMemory, FunctionCodec, MemorySequence, Plugins, context, jpeg
from rendered_scenes import CAMERA as VIEW
from rendered_scenes import Room, path_pose
from scipy.spatial.transform import Rotation

from codecbench.core.contracts.errors import Unsupported
from codecbench.core.contracts.evaluator import Measurement
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.sequence import Camera, Frame, Trajectory
from codecbench.core.engine.planning.description import without_defaults
from codecbench.plugins.evaluators.localization import Localization, _frame_measurements
from codecbench.plugins.evaluators.reference_map import LocalizedPose
from codecbench.plugins.links.constant import Constant, Ideal
from codecbench.plugins.slam_backends.orb import Orb

CAMERA = Camera(VIEW.width, VIEW.height, VIEW.fx, VIEW.fy, VIEW.cx, VIEW.cy)
FRAMES = 45
STEP_S = 1.0 / 15.0


class Film(MemorySequence):
    """A walk through the room, 10 metres to a unit; what is kept beside frames stays, as in a worker."""

    def __init__(self, camera: Camera | None = CAMERA, truth: bool = True, images: list[Image] | None = None) -> None:
        poses = np.linalg.inv([path_pose(step) for step in range(FRAMES)])
        poses[:, :3, 3] *= 10.0
        stamps_s = STEP_S * np.arange(FRAMES)
        super().__init__(images or list(room()), camera, Trajectory(stamps_s, poses) if truth else None)
        self.timestamps_s = stamps_s
        self.frames = [Frame(i, float(stamps_s[i]), image) for i, image in enumerate(self.images)]

    def read(self, index: int) -> Frame:
        return self.frames[index]


@cache
def room() -> tuple[Image, ...]:
    view = Room()
    return tuple(view.image(path_pose(step)) for step in range(FRAMES))


def plugins() -> Plugins:
    return Plugins(orb=lambda params: Orb.create(**{"features": 600, **params}))


def measured(sequence: MemorySequence, folder: Path, codec: FunctionCodec | None = None) -> list[Measurement]:
    return list(Localization.create().evaluate(CodedInMemory(sequence, codec), context(folder, 0, plugins())))


def values(found: list[Measurement], metric: str) -> np.ndarray:
    return np.array([m.value for m in found if m.metric == metric])


@pytest.mark.thorough
def test_raw_frames_are_where_they_were_and_worse_ones_are_not(tmp_path: Path) -> None:
    film = Film()
    raw = measured(film, tmp_path)
    asked = np.isfinite(values(raw, "tracked_located"))
    assert {m.metric for m in raw} == {metric.name for metric in Localization.metrics}
    assert sorted(m.frame or 0 for m in raw if m.metric == "tracked_located") == list(range(FRAMES))
    assert asked.sum() >= 10
    for way in ("tracked", "relocalized"):
        assert np.nanmean(values(raw, f"{way}_located")) > 0.9
        assert np.nanmedian(values(raw, f"{way}_position_error_mm")) < 600.0  # of a walk of 16 m
        # The path is nearly straight, which leaves the map's turn about it open, but the same for all frames.
        assert np.nanstd(values(raw, f"{way}_rotation_error_deg")) < 1.0
        assert np.nanmax(values(raw, f"{way}_position_to_raw_mm")) == 0.0
        assert np.nanmax(values(raw, f"{way}_rotation_to_raw_deg")) < 1e-5
    assert np.nanmin(values(raw, "located_auc")) == 1.0
    means = []
    for quality in (60, 15, 4):
        worse = measured(film, tmp_path, FunctionCodec(lambda image, q=quality: jpeg(image, q)))
        np.testing.assert_array_equal(np.isfinite(values(worse, "tracked_located")), asked)
        means.append([np.nanmean(values(worse, name)) for name in ("located_auc", "tracked_inliers")])
    areas, points = zip(*means, strict=True)
    assert 1.0 > areas[0] > max(areas[1:])
    assert np.nanmean(values(raw, "tracked_inliers")) > points[0] > points[1] > points[2]
    assert [(m.metric, m.frame, str(m.value)) for m in measured(Film(), tmp_path)] == [
        (m.metric, m.frame, str(m.value)) for m in raw
    ]


@pytest.mark.thorough
def test_the_frames_that_the_map_is_made_of_are_not_asked(tmp_path: Path) -> None:
    film = Film()
    built = Orb.create(features=600).map_of(film, CAMERA, seed=0)
    assert built is not None
    reasons: dict[int | None, str | None] = {
        m.frame: m.reason for m in measured(film, tmp_path) if m.metric == "tracked_located" and math.isnan(m.value)
    }
    assert {frame for frame, reason in reasons.items() if "a keyframe" in str(reason)} == set(
        built.keyframe_indices.tolist()
    )
    assert {0, 1} <= reasons.keys()


@pytest.mark.thorough
def test_pictures_with_nothing_in_them_are_nowhere(tmp_path: Path) -> None:
    found = measured(Film(), tmp_path, FunctionCodec(np.zeros_like))
    for name in ("tracked_located", "tracked_inliers", "relocalized_located", "relocalized_inliers", "located_auc"):
        assert np.nanmax(values(found, name)) == 0.0
    assert all(math.isnan(m.value) for m in found if m.metric.endswith("_mm"))


@pytest.mark.thorough
def test_a_film_of_nothing_makes_no_map(tmp_path: Path) -> None:
    with pytest.raises(Unsupported, match="make no map"):
        measured(Film(images=[np.full((240, 320), 90, np.uint8)] * FRAMES), tmp_path)


def test_a_sequence_without_ground_truth_or_camera_is_unsupported(tmp_path: Path) -> None:
    gray = [np.full((240, 320), 90, np.uint8)] * FRAMES
    for lacking, words in (
        (Film(truth=False, images=gray), "no ground truth"),
        (Film(camera=None, images=gray), "no camera"),
    ):
        with pytest.raises(Unsupported, match=words):
            measured(lacking, tmp_path)


def test_the_backend_is_part_of_what_a_cell_is() -> None:
    evaluator = Localization.create(backend_params={"features": 500})
    (use,) = evaluator.uses
    assert (use.kind, use.name, use.params) == ("slam_backend", "orb", {"features": 500})


def localized(x_m: float, turn_deg: float, inliers: int = 80) -> LocalizedPose:
    pose = np.eye(4)
    pose[0, 3] = x_m
    pose[:3, :3] = Rotation.from_euler("y", turn_deg, degrees=True).as_matrix()
    return LocalizedPose(pose, inliers)


def judged(tracked: LocalizedPose | None, raw: LocalizedPose | None, truth: np.ndarray) -> dict[str, Measurement]:
    reference_map: Any = SimpleNamespace(truth=truth[None], limit_m=0.02, limit_deg=2.5)
    found = _frame_measurements(
        reference_map, 0, {"tracked": tracked, "relocalized": None}, {"tracked": raw, "relocalized": raw}
    )
    return {m.metric: m for m in found}


def test_distances_and_angles_are_those_made_by_hand() -> None:
    found = judged(localized(0.012, 3.0), localized(0.007, 1.0), np.eye(4))
    expected = {
        "tracked_located": 1.0, "tracked_inliers": 80.0,
        "tracked_position_error_mm": 12.0, "tracked_rotation_error_deg": 3.0,
        "tracked_position_to_raw_mm": 5.0, "tracked_rotation_to_raw_deg": 2.0, "located_auc": 0.75,
        "relocalized_located": 0.0, "relocalized_inliers": 0.0,
    }  # fmt: skip
    for name, value in expected.items():
        assert found[name].value == pytest.approx(value), name
    assert set(found) == {metric.name for metric in Localization.metrics}
    assert all("not located" in str(m.reason) for m in found.values() if math.isnan(m.value))
    assert judged(localized(0.03, 0.0), localized(0.0, 0.0), np.eye(4))["located_auc"].value == 0.0


@pytest.mark.parametrize(("x_m", "turn_deg", "points"), [(0.019, 2.4, 80.0), (0.021, 0.0, 0.0), (0.0, 2.6, 0.0)])
def test_map_points_count_where_the_pose_is_right(x_m: float, turn_deg: float, points: float) -> None:
    found = judged(localized(x_m, turn_deg), localized(0.0, 0.0), np.eye(4))
    assert (found["tracked_located"].value, found["tracked_inliers"].value) == (1.0, points)


@pytest.mark.thorough
def test_a_frame_repeated_wins_no_map_points(tmp_path: Path) -> None:
    """Every frame after the 30th is shown as the 30th, which is located: more than a step away that is wrong."""
    film = Film()
    shown = {film.frames[i].image.tobytes(): film.frames[min(i, 30)].image for i in range(FRAMES)}
    codec = FunctionCodec(lambda image: shown[image.tobytes()])
    raw, stuck = ({(m.metric, m.frame or 0): m.value for m in measured(film, tmp_path, each)} for each in (None, codec))
    for way in ("tracked", "relocalized"):
        asked = [i for i in range(FRAMES) if not math.isnan(raw[f"{way}_inliers", i])]
        before, after = [i for i in asked if i <= 30], [i for i in asked if i > 31]
        assert len(after) >= 5
        assert all(stuck[f"{way}_inliers", i] == raw[f"{way}_inliers", i] > 50.0 for i in before)
        assert [stuck[f"{way}_inliers", i] for i in after] == [0.0] * len(after)
        assert [stuck["relocalized_located", i] for i in after] == [1.0] * len(after)


def test_what_is_not_known_is_missing_and_what_is_lost_is_nothing() -> None:
    lost = judged(None, localized(0.0, 0.0), np.eye(4))
    assert (lost["tracked_located"].value, lost["tracked_inliers"].value, lost["located_auc"].value) == (0.0, 0.0, 0.0)
    unknown = judged(localized(0.0, 0.0), None, np.full((4, 4), np.nan))
    assert "no true pose" in str(unknown["tracked_position_error_mm"].reason)
    for name in ("tracked_position_to_raw_mm", "located_auc", "tracked_inliers", "relocalized_inliers"):
        assert "raw frame" in str(unknown[name].reason)


@pytest.mark.thorough
def test_frames_that_do_not_come_are_not_located(tmp_path: Path) -> None:
    film = Film()
    away = {"link": "constant", "link_params": {"rate_kbps": 1e6, "loss": 0.1}, "mtu": 60_000}
    where = Plugins(orb=plugins().factories["orb"], constant=lambda params: Constant.create(**params))
    without = {(m.metric, m.frame): m for m in measured(film, tmp_path)}
    evaluator = Localization.create(**away)
    over = {(m.metric, m.frame): m for m in evaluator.evaluate(CodedInMemory(film), context(tmp_path, 0, where))}
    assert over.keys() == without.keys()
    gone = {frame for (metric, frame), m in over.items() if metric == "tracked_located" and m.value == 0.0}
    assert 0 < len(gone) < FRAMES / 2
    assert all(without["tracked_located", frame].value == 1.0 for frame in gone)
    for (metric, frame), there in without.items():
        here = over[metric, frame]
        if frame not in gone:
            assert here == there or math.isnan(there.value)
        elif metric in ("located_auc", "tracked_inliers", "relocalized_located"):
            assert here.value == 0.0
        elif metric == "tracked_position_error_mm":
            assert math.isnan(here.value)


@pytest.mark.thorough
def test_frames_that_come_while_another_is_located_are_not(tmp_path: Path) -> None:
    """A reader that takes the time of 2.37 frames for each sees 0, 2, 4, 7 and so on."""
    film = Film()
    where = Plugins(orb=plugins().factories["orb"], ideal=lambda params: Ideal.create(**params))
    evaluator = Localization.create(link="ideal", slam_ms=0.79e3 * STEP_S, receiver_factor=3.0)
    found = {m.frame: m.value for m in evaluator.evaluate(CodedInMemory(film), context(tmp_path, 0, where))
             if m.metric == "tracked_located" and not math.isnan(m.value)}  # fmt: skip
    seen = {min(math.floor(2.37 * turn), FRAMES - 1) for turn in range(FRAMES)}
    assert {frame for frame, value in found.items() if value == 1.0} == seen & found.keys()
    assert found.keys() - seen


def test_without_a_link_a_cell_is_what_it_was() -> None:
    evaluator = Localization.create()
    assert without_defaults(evaluator.repeat_identity(0), evaluator.params) == {}
    assert [use.kind for use in Localization.create(link="ideal").uses] == ["slam_backend", "link"]
