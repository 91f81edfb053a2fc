"""What evaluators make of a codec that sends features, and of one of pictures where features are asked for."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from codecbench_corners.codec import Corners, CornersDecoder, CornersEncoder
from feature_streams import PICTURES, coded_features
from held_clock import CLOCK, held_clock
from memory_sequence import CodedInMemory, MemorySequence, Plugins, context
from rendered_scenes import CAMERA as VIEW
from rendered_scenes import Room, looking
from synthetic_path import Told, helix

from codecbench import Features, Unsupported
from codecbench.core.contracts.evaluator import Measurement
from codecbench.core.contracts.features import FeatureFrame, FeatureSet
from codecbench.core.contracts.sequence import Camera, Trajectory
from codecbench.core.contracts.slam import SlamRun
from codecbench.core.contracts.stream import Loss, Packet
from codecbench.plugins.evaluators.delivery import DeliveryEvaluator
from codecbench.plugins.evaluators.localization import Localization
from codecbench.plugins.evaluators.quality import Quality
from codecbench.plugins.evaluators.relative_pose import RelativePose
from codecbench.plugins.evaluators.stream import Stream
from codecbench.plugins.evaluators.timing import Timing
from codecbench.plugins.evaluators.trajectory import TrajectoryEvaluator
from codecbench.plugins.links.constant import Constant

CAMERA = Camera(VIEW.width, VIEW.height, VIEW.fx, VIEW.fy, VIEW.cx, VIEW.cy)
PLUGINS = Plugins(constant=lambda params: Constant.create(**params))
COUNT = len(PICTURES)


def values(found: Iterable[Measurement], metric: str) -> list[float]:
    return [one.value for one in found if one.metric == metric]


def test_a_rate_is_measured_and_nothing_of_pictures(tmp_path: Path) -> None:
    coded = coded_features(Corners.create(gop=3))
    found = list(Quality.create().evaluate(coded, context(tmp_path)))
    height, width = PICTURES[0].shape
    sizes = [coded.size_bytes(index) for index in range(COUNT)]
    assert values(found, "rate_bpp") == [8.0 * size / (width * height) for size in sizes]
    missing = {one.metric: one.reason for one in found if math.isnan(one.value)}
    assert missing.keys() == {"psnr_gray_db", "ssim_matlab", "ssim_wang", "ms_ssim"}
    assert all("sends features" in str(reason) for reason in missing.values())


def test_joining_waits_for_the_next_packet_that_starts(tmp_path: Path) -> None:
    found = list(Stream.create(joins=3).evaluate(coded_features(Corners.create(gop=3)), context(tmp_path)))
    assert values(found, "joining_worst_frames")[0] in (1.0, 2.0)
    assert values(found, "delay_frames") == [0.0]
    never = list(Stream.create(joins=3).evaluate(coded_features(Corners.create(gop=100)), context(tmp_path)))
    assert math.isnan(values(never, "joining_frames")[0])


def test_what_depends_on_a_lost_set_is_not_handed_on(tmp_path: Path) -> None:
    params = {"link": "constant", "link_params": {"rate_kbps": 1e6, "loss": 0.05}}
    sequence = MemorySequence(PICTURES * 4)
    coded = coded_features(Corners.create(gop=8), sequence)
    where = context(tmp_path, plugins=PLUGINS)
    found = list(DeliveryEvaluator.create(**params, concealed=True).evaluate(coded, where))
    assert values(found, "concealed_share") == [0.0]
    assert values(found, "broken_share")[0] > 0.0
    again = list(DeliveryEvaluator.create(**params, architecture="features").evaluate(coded, where))
    assert values(again, "on_time") == values(found, "on_time")


@pytest.mark.parametrize(
    "evaluator",
    [
        DeliveryEvaluator.create(architecture="features"),
        RelativePose.create(architecture="features"),
        Localization.create(architecture="features"),
        TrajectoryEvaluator.create(backend="told", architecture="features"),
    ],
    ids=lambda evaluator: evaluator.name,
)
def test_image_codecs_are_refused_under_architecture_features(evaluator: Any, tmp_path: Path) -> None:
    plugins = Plugins(told=lambda _: Told(helix(COUNT)), orb=lambda _: None)
    coded = CodedInMemory(MemorySequence(PICTURES, CAMERA))
    with pytest.raises(Unsupported, match="architecture: features"):
        list(evaluator.evaluate(coded, context(tmp_path, plugins=plugins)))


class SlowEncoder(CornersEncoder):
    def push(self, features: Features) -> Packet:
        CLOCK.sleep(0.005)
        return super().push(features)


class SlowDecoder(CornersDecoder):
    def push(self, packet: Packet | Loss) -> FeatureSet:
        CLOCK.sleep(0.003)
        return super().push(packet)


class Slow(Corners):
    """Finding takes 20 ms, coding 5 ms, decoding 3 ms."""

    def extract(self, image: np.ndarray) -> Features:
        CLOCK.sleep(0.02)
        return super().extract(image)

    def encoder(self) -> SlowEncoder:
        return SlowEncoder(self.params)

    def decoder(self) -> SlowDecoder:
        return SlowDecoder()


@pytest.mark.usefixtures(held_clock.__name__)
def test_what_the_device_does_is_timed_and_finding_apart(tmp_path: Path) -> None:
    found = list(Timing.create(frames=3, warmup=1).evaluate(Slow.create(), MemorySequence(PICTURES), context(tmp_path)))
    whole = [one.value for one in found if one.metric == "encode_wall_ms" and one.stage is None]
    finding = [one.value for one in found if one.metric == "encode_wall_ms" and one.stage == "encode/extract"]
    assert finding == pytest.approx([20] * 3)
    assert whole == pytest.approx([25] * 3)
    assert values(found, "decode_wall_ms") == pytest.approx([3] * 3)


def room_sequence() -> MemorySequence:
    """A camera that slides to its right past a corner of a room."""
    room, yaw = Room(), 0.8
    right = np.array([np.cos(yaw), 0.0, -np.sin(yaw)])
    poses = [looking(tuple((0.1 * step - 0.4) * right), yaw + 0.01 * step) for step in range(8)]
    truth = Trajectory(np.arange(8) / 10.0, np.linalg.inv(poses))
    return MemorySequence([room.image(pose) for pose in poses], CAMERA, truth)


def test_motion_is_found_from_the_features_that_come(tmp_path: Path) -> None:
    """They are those that the evaluator finds in raw pictures, so that nothing differs from these."""
    params = {"baselines": (0.05,), "keypoints": 600}
    sequence = room_sequence()
    found = list(RelativePose.create(**params).evaluate(coded_features(Corners.create(), sequence), context(tmp_path)))
    raw = list(RelativePose.create(**params).evaluate(CodedInMemory(sequence), context(tmp_path)))
    known = [value for value in values(found, "correct_matches") if not math.isnan(value)]
    assert min(known) > 10
    for metric in ("matches_lost", "correct_matches", "pose_error_deg"):
        assert np.array_equal(values(found, metric), values(raw, metric), equal_nan=True)
    coded = coded_features(Corners.create(), sequence)
    with pytest.raises(Unsupported, match="detector sift"):
        list(RelativePose.create(**params, detector="sift").evaluate(coded, context(tmp_path)))


class ToldOfFeatures(Told):
    """Takes features, too."""

    architectures = frozenset({"cta", "features"})

    def run_features(self, frames: Iterable[FeatureFrame], camera: Camera, *, seed: int) -> SlamRun:
        return self.run(frames, camera, seed=seed)


@pytest.mark.parametrize("architecture", ["cta", "features"])
def test_slam_gets_the_features_and_all_packets_are_sent(architecture: str, tmp_path: Path) -> None:
    backend, codec = ToldOfFeatures(helix(COUNT)), Corners.create(gop=3)
    evaluator = TrajectoryEvaluator.create(backend="told", architecture=architecture, start_offsets=[2])
    coded = coded_features(codec, MemorySequence(PICTURES, CAMERA))
    found = list(evaluator.evaluate(coded, context(tmp_path, plugins=Plugins(told=lambda _: backend))))
    assert [frame.index for frame in backend.seen] == list(range(2, COUNT))
    for frame in backend.seen:
        assert isinstance(frame, FeatureFrame)
        assert frame.timestamp_s == frame.index / 10.0
        assert np.array_equal(frame.features.descriptors, codec.extract(PICTURES[frame.index]).descriptors)
    assert values(found, "sent_size_bytes") == [sum(coded.size_bytes(index) for index in range(2, COUNT))]


def test_features_are_refused_by_what_needs_images(tmp_path: Path) -> None:
    coded = coded_features(Corners.create(), MemorySequence(PICTURES, CAMERA))
    where = context(tmp_path, plugins=Plugins(told=lambda _: Told(helix(COUNT))))
    with pytest.raises(Unsupported, match=r"architecture features; .* atc, cta"):
        list(TrajectoryEvaluator.create(backend="told").evaluate(coded, where))
    with pytest.raises(Unsupported, match="corners sends features"):
        list(TrajectoryEvaluator.create(backend="told", architecture="atc").evaluate(coded, where))
    with pytest.raises(Unsupported, match="told accepts images"):
        Told(helix(COUNT)).run_features([], CAMERA, seed=0)
