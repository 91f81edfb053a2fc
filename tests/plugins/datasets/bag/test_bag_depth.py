"""Depth in recordings: every encoding becomes the distances that it was made of."""

from __future__ import annotations

import struct

import cv2
import numpy as np
import pytest
from bag_files import BagWriter, picture, time_ns

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.image import Layout
from codecbench.core.contracts.sequence import Depth
from codecbench.plugins.codecs.rvl import Rvl
from codecbench.plugins.datasets.bag.dataset import Bag

STEPS = np.random.default_rng(5).integers(400, 9000, (24, 32), dtype=np.uint16)
STEPS[:, :5] = 0
METERS = np.where(STEPS > 0, STEPS / 1000.0, np.nan).astype(np.float32)


def opened(tmp_path, make, topic="/camera/depth/image_raw", **values):
    path = tmp_path / "a.mcap"
    with BagWriter(path, "mcap") as bag:
        bag.write(topic, make(bag), time_ns(0))
    return Bag.create(path=path, **values).open()


def png(pixels, a=0.0, b=0.0):
    return struct.pack("<iff", 0, a, b) + cv2.imencode(".png", pixels)[1].tobytes()


def rvl(pixels, a=0.0, b=0.0):
    return struct.pack("<iff", 0, a, b) + Rvl.create().encode(pixels)[12:]


@pytest.mark.parametrize("write", [
    lambda bag: bag.image(STEPS, "16UC1", time_ns(0)),
    lambda bag: bag.image(STEPS, "16UC1", time_ns(0), padding=6, big=True),
    lambda bag: bag.image(METERS, "32FC1", time_ns(0)),
    lambda bag: bag.compressed_image(png(STEPS), "16UC1; compressedDepth png", time_ns(0)),
    lambda bag: bag.compressed_image(png(STEPS), "16UC1; compressedDepth", time_ns(0)),
    lambda bag: bag.compressed_image(rvl(STEPS), "16UC1; compressedDepth rvl", time_ns(0)),
])  # fmt: skip
def test_depth_is_what_it_was_made_of(tmp_path, write):
    sequence = opened(tmp_path, write)
    assert (sequence.layout, sequence.depth) == (Layout(1, 16), Depth(0.001))
    assert np.array_equal(sequence.read(0).image, STEPS)


@pytest.mark.parametrize("coded", [png, rvl])
def test_inverse_depth_is_within_a_step_of_its_codes(tmp_path, coded):
    """By the formula of the transport: A = Z0 (Z0 + 1), B = 1 - A / max, code = trunc(A / z + B)."""
    a = 100.0 * 101.0
    b = 1.0 - a / 10.0
    with np.errstate(invalid="ignore"):
        codes = np.where(METERS < 10.0, np.trunc(a / METERS + b), 0)
    content = coded(np.nan_to_num(codes).astype(np.uint16), a, b)
    sequence = opened(
        tmp_path, lambda bag: bag.compressed_image(content, f"32FC1; compressedDepth {coded.__name__}", 9)
    )
    image, known = sequence.read(0).image, STEPS > 0
    assert ((image == 0) == ~known).all()
    assert "ALREADY CODED" in " ".join(sequence.notes)
    step_m = METERS.astype(float)[known] ** 2 / a
    assert (np.abs(image[known] / 1000.0 - METERS[known]) <= step_m + 0.0006).all()


def test_meters_that_are_no_distance_are_unknown(tmp_path):
    meters = np.array([[np.nan, np.inf, -np.inf, -1.0, 0.0, 0.0004, 65.536, 1.2344]], np.float32)
    sequence = opened(tmp_path, lambda bag: bag.image(meters, "32FC1", time_ns(0)), depth_unknown=65535)
    assert sequence.read(0).image.tolist() == [[65535] * 7 + [1234]]
    fine = opened(tmp_path / "fine", lambda bag: bag.image(meters, "32FC1", time_ns(0)), depth_unit_m=0.0001)
    assert fine.depth == Depth(0.0001)
    assert fine.read(0).image.tolist() == [[0] * 5 + [4, 0, 12344]]


def test_16_bits_are_intensities_unless_the_topic_is_called_depth(tmp_path):
    def write(bag):
        return bag.image(STEPS, "16UC1", time_ns(0))

    eight = opened(tmp_path / "8", write, topic="/thermal/image_raw")
    assert (eight.layout, eight.depth) == (Layout(1), None)
    deep = opened(tmp_path / "16", write, topic="/thermal/image_raw", samples="16_bits")
    assert (deep.layout, deep.depth) == (Layout(1, 16), None)
    assert np.array_equal(deep.read(0).image, STEPS)
    depth = opened(tmp_path / "d", write, topic="/range", samples="depth", depth_unit_m=0.01)
    assert depth.depth == Depth(0.01)
    assert len({sequence.fingerprint for sequence in (eight, deep, depth)}) == 3
    with pytest.raises(DatasetError, match="frames of 16 bits are gray: set `samples: 8_bits`"):
        opened(tmp_path / "c", lambda bag: bag.image(picture(1).astype(np.uint16), "rgb16", 9), samples="16_bits")
    with pytest.raises(DatasetError, match="has samples of uint8; depth has 16 bits"):
        opened(tmp_path / "m", lambda bag: bag.image(picture(1, (24, 32)), "mono8", 9), samples="depth")
