"""What is sent for SLAM on a codec with memory: the whole stream, or a stream of the keyframes alone."""

from __future__ import annotations

from io import BytesIO

import numpy as np
import pytest
from codecbench_delta.codec import Delta
from memory_sequence import MemorySequence

from codecbench import Image, Unsupported
from codecbench.core.engine.running.coding.coded_frames import CodedFrames
from codecbench.core.engine.running.coding.encoding import encode_sequence
from codecbench.core.engine.running.coding.position import WorkPosition
from codecbench.core.engine.storage.bitstream_file import BitstreamFile, write_stream
from codecbench.plugins.evaluators.trajectory.feed import Feed

FRAMES = 12
JOB = "0f" * 16


@pytest.fixture
def images(rng: np.random.Generator) -> list[Image]:
    """Noise that drifts: frames far apart differ more, and their difference is larger."""
    steps = rng.integers(0, 8, (FRAMES, 24, 32))
    return [image.astype(np.uint8) for image in np.cumsum(steps, axis=0)]


def coded(images: list[Image], **params: int) -> CodedFrames:
    sequence, codec, stream = MemorySequence(images), Delta.create(**params), BytesIO()
    write_stream(stream, encode_sequence(codec, sequence, WorkPosition()), JOB)
    return CodedFrames(sequence, codec, BitstreamFile(stream.getvalue(), JOB), WorkPosition())


def sizes(images: list[Image]) -> list[int]:
    """Bytes of the packets of these images as a stream."""
    encoder = Delta.create(gop=100).encoder(10.0)
    return [len(packet.data) for image in images for packet in encoder.push(image)]


def test_under_cta_the_whole_stream_is_sent(images: list[Image]) -> None:
    feed = Feed(coded(images, gop=100), "cta", 2)
    assert feed.keyframe_image is None
    assert [frame.index for frame in feed.frames()] == list(range(2, FRAMES))
    assert feed.sent_size_bytes() == sum(sizes(images)[2:])


def test_under_atc_keyframes_are_the_stream_and_are_sent_once(images: list[Image]) -> None:
    feed = Feed(coded(images, gop=100), "atc", 0)
    assert feed.keyframe_image is not None
    assert feed.sent_size_bytes() == 0
    for index in (0, 3, 3, 10, 0):
        assert np.array_equal(feed.keyframe_image(index), images[index])
    expected = sizes([images[0], images[3], images[10]])
    assert feed.sent_size_bytes() == sum(expected)
    assert expected[1] > sizes(images)[3]  # the difference to frame 0, not to frame 2


def test_under_atc_frames_that_are_held_back_are_unsupported(images: list[Image]) -> None:
    feed = Feed(coded(images, hold=2), "atc", 0)
    assert feed.keyframe_image is not None
    with pytest.raises(Unsupported, match="holds frames back"):
        feed.keyframe_image(0)
    assert Feed(coded(images, hold=2), "cta", 0).sent_size_bytes() == sum(sizes(images))
