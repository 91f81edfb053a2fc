"""RVL against a transcription of its description, with streams and damage made by hand."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np
import pytest
from damage import outcomes
from depth_frames import IMAGES, real_frames

from codecbench import BitstreamError, Image
from codecbench.core.counting.trace import CountingTrace
from codecbench.plugins.codecs.rvl import Rvl

EVERY_IMAGE = pytest.mark.parametrize("content", IMAGES)
ROS_HEADER = struct.Struct("<iffii")


def nibbles_of(number: int) -> list[int]:
    """Three bits a nibble, the lowest first; the fourth bit says that there are more."""
    digits = [int(digit) for digit in reversed(f"{number:o}")]
    return [digit + 8 for digit in digits[:-1]] + digits[-1:]


def paper_encoder(image: Image) -> bytes:
    """The published scheme in text: hexadecimal digits, eight of which are a word."""
    values, digits, previous = [int(value) for value in image.ravel()], [], 0
    while values:
        zeros = next((place for place, value in enumerate(values) if value != 0), len(values))
        run = values[zeros:]
        run = run[: next((place for place, value in enumerate(run) if value == 0), len(run))]
        values = values[zeros + len(run) :]
        digits += nibbles_of(zeros) + nibbles_of(len(run))
        for value in run:
            delta, previous = value - previous, value
            digits += nibbles_of(2 * delta if delta >= 0 else -2 * delta - 1)
    text = "".join(f"{digit:x}" for digit in digits)
    text += "0" * (-len(text) % 8)
    words = b"".join(bytes.fromhex(text[place : place + 8])[::-1] for place in range(0, len(text), 8))
    return ROS_HEADER.pack(0, 0, 0, image.shape[1], image.shape[0]) + words


def paper_decoder(bitstream: bytes) -> Image:
    *_, width, height = ROS_HEADER.unpack_from(bitstream)
    content = bitstream[ROS_HEADER.size :]
    digits = iter("".join(content[place : place + 4][::-1].hex() for place in range(0, len(content), 4)))
    values: list[int] = []
    previous = 0
    while len(values) < width * height:
        values += [0] * number_from(digits)
        for _ in range(number_from(digits)):
            folded = number_from(digits)
            previous += -(folded + 1) // 2 if folded % 2 else folded // 2
            values.append(previous)
    return np.array(values, np.uint16).reshape(height, width)


def number_from(digits: Iterator[str]) -> int:
    number, unit = 0, 1
    for digit in digits:
        number += unit * (int(digit, 16) % 8)
        unit *= 8
        if int(digit, 16) < 8:
            break
    return number


@EVERY_IMAGE
def test_bitstreams_are_those_of_the_published_scheme_in_a_message_of_ros(content: str) -> None:
    codec, image = Rvl.create(), IMAGES[content]
    bitstream = codec.encode(image)
    assert bitstream == paper_encoder(image)
    np.testing.assert_array_equal(paper_decoder(bitstream), image)
    np.testing.assert_array_equal(codec.decode(paper_encoder(image)), image)


def test_real_frames_are_coded_as_published() -> None:
    for frame in real_frames()[:2]:
        assert Rvl.create().encode(frame[::3]) == paper_encoder(frame[::3])


def test_a_stream_worked_by_hand() -> None:
    """Two holes, then 9, 8, 16: runs 2 and 3; 9 is 18 = 22 octal, -1 is 1, 8 is 16 = 20 octal; then 1 and 0."""
    image = np.array([[0, 0, 9], [8, 16, 0]], np.uint16)
    bitstream = ROS_HEADER.pack(0, 0, 0, 3, 2) + struct.pack("<II", 0x23_A2_1_82_1, 0x0000_0000)
    assert Rvl.create().encode(image) == bitstream
    np.testing.assert_array_equal(Rvl.create().decode(bitstream), image)


def test_parameters_of_other_formats_are_not_read() -> None:
    """Old releases of ROS 1 left them undefined."""
    bitstream = Rvl.create().encode(IMAGES["holes"])
    foreign = bitstream[:4] + struct.pack("<ff", 10100, -99) + bitstream[12:]
    np.testing.assert_array_equal(Rvl.create().decode(foreign), IMAGES["holes"])


@pytest.mark.parametrize(
    ("sides", "words", "reason"),
    [
        ((3, 1), (0x0322_0000, 0), "left over"),
        ((3, 1), (0x3000_0001,), "left over"),
        ((3, 1), (0x4000_0000,), "run"),
        ((3, 1), (0x2200_0000,), "run"),
        ((3, 1), (0x1000_0000,), "run"),
        ((3, 1), (0x0120_1200,), "run"),
        ((3, 1), (0x0311_1000,), "1..65535"),
        ((1, 1), (0x01FF_FFF7,), "1..65535"),
        ((1, 1), (0x01FF_FFFF, 0xFFFF_FFFF), "1..65535"),
        ((9, 1), (0x0912_2222,), "ends before"),
        ((9, 1), (0xFFFF_FFFF, 0xFFFF_FFFF), "run"),
        ((0, 5), (0,), "0x5"),
        ((1 << 16, 1 << 16), (0,), "65536x65536"),
        ((-1, -1), (0,), "pixels"),
    ],
)
def test_streams_that_no_encoder_writes_are_refused(
    sides: tuple[int, int], words: tuple[int, ...], reason: str
) -> None:
    with pytest.raises(BitstreamError, match=reason):
        Rvl.create().decode(ROS_HEADER.pack(0, 0, 0, *sides) + struct.pack(f"<{len(words)}I", *words))


@EVERY_IMAGE
def test_cut_and_lengthened_streams_are_refused(content: str) -> None:
    codec = Rvl.create()
    bitstream = codec.encode(IMAGES[content])
    ends = {*range(24), *range(len(bitstream) - 9, len(bitstream))}
    for damaged in [bitstream[:end] for end in ends if end >= 0] + [bitstream + bytes(more) for more in (1, 2, 4, 8)]:
        with pytest.raises(BitstreamError):
            codec.decode(damaged)


def test_damage_is_survived() -> None:
    found = outcomes(Rvl.create(), [Rvl.create().encode(IMAGES[name]) for name in ("holes", "noise")], 3_000, seed=4)
    assert found["refused"] > 1_500


def test_operations_are_those_of_the_pixels() -> None:
    """A constant frame has a nibble a pixel. Each is read to measure the run and to code it; the first ends a hole."""
    trace = CountingTrace()
    bitstream = Rvl.create().encode(np.full((20, 30), 7, np.uint16), trace=trace)
    assert len(bitstream) == 20 + 4 * -(-(1 + 4 + 2 + 599) // 8)
    (counts,) = trace.counts.values()
    assert (counts.reads, counts.mults, counts.divisions) == (2 * 600 + 1, 0, 0)
    assert counts.writes == 600 + 1, "of a word for each pixel, and of the last"
