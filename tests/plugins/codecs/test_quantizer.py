"""Quantized depth, against answers worked by hand from the published formulas."""

from __future__ import annotations

import math
import zlib
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from codecbench import BitstreamError
from codecbench.plugins.codecs.quantizer import DepthParams, DepthScale

PIXELS = np.arange(1 << 16, dtype=np.uint16).reshape(256, 256)
ROS: dict[str, Any] = {"quantizer": "inverse", "depth_bits": 16, "far_m": 10.0, "depth_quantization": 100.0}
LEROBOT: dict[str, Any] = {"quantizer": "log", "depth_bits": 12, "far_m": 10.0}
LINEAR: dict[str, Any] = {"quantizer": "linear", "depth_bits": 12, "far_m": 10.0}


def code(params: DepthParams, pixel: int) -> int:
    return int(params.codes(np.array([[pixel]], np.uint16))[0, 0])


def pixel(params: DepthParams, code: int) -> int:
    return int(params.depth_scale.pixels(np.array([[code]], np.uint16))[0, 0])


@pytest.mark.parametrize(
    ("setting", "depth_mm", "expected"),
    [
        (ROS, 1000, 9091),  # A = 100 101 = 10100, B = 1 - 1010 = -1009: 10100 / 1 - 1009
        (ROS, 2000, 4041),  # 5050 - 1009
        (ROS, 7000, 433),  # 1442.86 - 1009, truncated
        (ROS, 9999, 1),  # 1010.1 - 1009
        (ROS, 10000, 0),  # not below the farthest distance
        (ROS, 100, 65535),  # 99991, of which a cast to 16 bits is undefined
        (LEROBOT, 1000, 755),  # 4095 ln(4.5 / 3.51) / ln(13.5 / 3.51) = 755.30
        (LEROBOT, 10000, 4095),
        (LEROBOT, 20000, 4095),
        (LEROBOT, 10, 1),  # 0 by the formula, which stands for no distance here
        (LINEAR, 5005, 2048),  # 4095 4.995 / 9.99 = 2047.5, to even
        (LINEAR, 15, 2),  # 4095 0.005 / 9.99 = 2.05
    ],
)
def test_codes_are_those_of_the_published_formulas(setting: dict[str, Any], depth_mm: int, expected: int) -> None:
    assert code(DepthParams(**setting), depth_mm) == expected


def test_codes_decode_to_their_distance() -> None:
    ros, lerobot, linear = (DepthParams(**setting) for setting in (ROS, LEROBOT, LINEAR))
    assert (pixel(ros, 9091), pixel(ros, 433), pixel(ros, 1)) == (1000, 7004, 10000)  # 10100 / (433 + 1009) = 7.0042
    assert (pixel(lerobot, 755), pixel(lerobot, 4095)) == (1000, 10000)  # 3.51 exp(755 1.347073 / 4095) - 3.5 = 0.99955
    assert (pixel(linear, 2048), pixel(linear, 1)) == (5006, 12)  # 0.01 + 2048 0.00243956 = 5.00622


@pytest.mark.parametrize("unknown", [0, 65535])
@pytest.mark.parametrize("bits", [10, 12, 16])
@pytest.mark.parametrize("quantizer", ["log", "linear", "inverse"])
def test_errors_are_half_a_step_and_the_unknown_stays(quantizer: Any, bits: Any, unknown: Any) -> None:
    params = DepthParams(quantizer=quantizer, depth_bits=bits, depth_unknown=unknown)
    decoded = params.depth_scale.pixels(params.codes(PIXELS)).ravel().astype(float)
    assert decoded[unknown] == unknown
    depth_mm = np.arange(1 << 16)
    nearest, farthest = pixel(params, (1 << bits) - 1 if quantizer == "inverse" else 1), 65534
    known = (depth_mm >= nearest) & (depth_mm < farthest)
    assert (decoded[known] != unknown).all()
    last = (1 << bits) - 1
    if quantizer == "inverse":  # truncated: up to a whole step, to the far side
        step_mm = depth_mm**2 / (930e3 - depth_mm)  # from 1 / z to 1 / z - 1 / A
        least, most = np.full(1 << 16, -0.51), step_mm + 0.51
    else:
        shift_mm, span_mm = 3500, 65525
        step_mm = (depth_mm + shift_mm) * math.log(69.035 / 3.51) / last if quantizer == "log" else span_mm / last
        most = step_mm / 2 * (1 + step_mm / 5000) + 0.51 + 0 * depth_mm
        least = -most
    error_mm = decoded - depth_mm
    assert (error_mm[known] <= most[known]).all()
    assert (error_mm[known] >= least[known]).all()


def test_tables_are_the_same_on_every_machine() -> None:
    for setting, checksum in ((ROS, 0xB5827CA2), (LEROBOT, 0x7354776B), (LINEAR, 0xA559B17A)):
        params = DepthParams(**setting)
        codes = params.codes(PIXELS)
        assert zlib.crc32(codes.tobytes() + params.depth_scale.pixels(codes).tobytes()) == checksum


def test_a_scale_comes_back_from_its_bytes_and_a_damaged_one_is_refused() -> None:
    scale = DepthParams(**ROS).depth_scale
    sent = scale.to_bytes()
    assert sent.hex() == "03100000" + np.array([0.001, 10100, -1009, 0, 0], "<f8").tobytes().hex()
    assert DepthScale.parse(sent) == scale
    for place, value in ((0, 4), (1, 11), (2, 1), (10, 255)):
        damaged = bytearray(sent)
        damaged[place : place + 2] = bytes([value, damaged[place + 1]]) if place < 10 else b"\xf0\x7f"
        with pytest.raises(BitstreamError, match="scale is damaged"):
            DepthScale.parse(bytes(damaged))
    zeros = DepthScale("inverse", 10, 0, 0.0, 0.0, 0.0, 0.0)
    assert zeros.pixels(PIXELS).shape == PIXELS.shape, "no bitstream makes tables fail"


@pytest.mark.parametrize(
    ("setting", "pattern"),
    [
        ({"quantizer": "none"}, "none takes 16 bits, not 12; .* linear, log, inverse"),
        ({"quantizer": "inverse", "shift_m": 1.0}, "quantizer is inverse, but shift_m is for log depth; leave"),
        ({"depth_quantization": 75.0}, "log, but depth_quantization is for inverse"),
        ({"near_m": 20.0, "far_m": 10.0}, "near_m must be below far_m, got 20 and 10"),
        ({"depth_bits": 11}, "depth_bits"),
    ],
)
def test_parameters_that_make_no_sense_are_refused(setting: dict[str, Any], pattern: str) -> None:
    with pytest.raises(ValidationError, match=pattern):
        DepthParams(**setting)


def test_distances_below_the_nearest_valid_one_are_none() -> None:
    params = DepthParams(far_m=10.0, valid_from_m=0.4)
    decoded = params.depth_scale.pixels(np.arange(1 << 12, dtype=np.uint16))
    plain = DepthParams(far_m=10.0).depth_scale.pixels(np.arange(1 << 12, dtype=np.uint16))
    assert np.array_equal(decoded, np.where(plain < 400, 0, plain))
    assert DepthScale.parse(params.depth_scale.to_bytes()) == params.depth_scale
