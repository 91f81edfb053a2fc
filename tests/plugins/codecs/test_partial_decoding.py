"""Pictures of which packets are missing: what codecs make of the rest, and that they claim no more than is true."""

from __future__ import annotations

import numpy as np
import pytest
import skimage.data

from codecbench import BitstreamError, Fragment, Unsupported
from codecbench.plugins.codecs.jpeg import Jpeg
from codecbench.plugins.codecs.jpeg2000 import Jpeg2000
from codecbench.plugins.codecs.jpeg_restart import salvage
from codecbench.plugins.codecs.multilevel.codec import Multilevel
from codecbench.plugins.codecs.png import Png

PICTURE = skimage.data.astronaut()[:250, :301]
GRAY = skimage.data.camera()[::2, ::2]


def without(bitstream: bytes, *gaps: tuple[int, int]) -> list[Fragment]:
    """What is there of a bitstream but for some ranges of it, which are in order."""
    bounds = [0, *(place for gap in gaps for place in gap), len(bitstream)]
    pairs = zip(bounds[::2], bounds[1::2], strict=True)
    return [Fragment(begin, bitstream[begin:end]) for begin, end in pairs if begin < end]


def restarts(bitstream: bytes) -> list[int]:
    """Where the restart markers of a JPEG file are."""
    return [i for i in range(len(bitstream)) if bitstream[i] == 0xFF and 0xD0 <= bitstream[i + 1] <= 0xD7]


@pytest.mark.parametrize(("image", "step"), [(PICTURE, 16), (GRAY, 8)], ids=["rgb", "gray"])
def test_rows_of_jpeg_outlive_those_between_them(image: np.ndarray, step: int) -> None:
    codec = Jpeg.create(quality=60, restart=1)
    bitstream = codec.encode(image)
    marks, whole = restarts(bitstream), codec.decode(bitstream)
    assert len(marks) == -(-len(image) // step) - 1
    found = codec.decode_partial(without(bitstream, (marks[2] + 9, marks[3] + 5)))  # rows 3 and 4, the fourth and fifth
    lost = np.flatnonzero(~found.whole.any(axis=1))
    margin = image.ndim == 3  # a row of chroma serves two rows of pixels, and is smoothed
    assert lost.tolist() == list(range(3 * step - margin, 5 * step + margin))
    assert np.array_equal(found.image[found.whole], whole[found.whole])
    between = found.image[4 * step].astype(int)
    ends = np.stack([found.image[3 * step - 1], found.image[5 * step]]).astype(int)
    assert ((between >= ends.min(axis=0)) & (between <= ends.max(axis=0))).all()


def test_more_rows_than_markers_tell_apart_are_found_by_the_end() -> None:
    codec = Jpeg.create(quality=60, restart=1)
    bitstream = codec.encode(GRAY)  # 32 intervals
    marks = restarts(bitstream)
    one_gap = codec.decode_partial(without(bitstream, (marks[3] + 3, marks[20] - 3)))
    assert np.flatnonzero(~one_gap.whole[:, 0]).tolist() == list(range(8 * 4, 8 * 21))
    two_gaps = codec.decode_partial(without(bitstream, (marks[3] + 3, marks[13] - 3), (marks[20] + 3, marks[22] + 3)))
    assert np.flatnonzero(two_gaps.whole[:, 0]).tolist() == [*range(8 * 4), *range(8 * 24, 256)]
    no_end = codec.decode_partial(without(bitstream, (marks[3] + 3, len(bitstream))))
    assert np.flatnonzero(no_end.whole[:, 0]).tolist() == [*range(8 * 4)]


def test_restart_markers_change_no_pixel_and_are_left_out_where_not_asked_for() -> None:
    plain, marked = Jpeg.create(quality=60), Jpeg.create(quality=60, restart=2)
    assert np.array_equal(plain.decode(plain.encode(PICTURE)), marked.decode(marked.encode(PICTURE)))
    assert restarts(plain.encode(PICTURE)) == []
    with pytest.raises(ValueError, match=r"restart .*sequential JPEG"):
        Jpeg.create(restart=1, progressive=True)


@pytest.mark.parametrize(
    ("params", "gap", "words"),
    [
        ({"restart": 1}, (0, 40), "header is missing"),
        ({"restart": 1}, (300, 900), "header is missing"),
        ({}, (2000, 2500), "no restart intervals"),
        ({"progressive": True}, (2000, 2500), "several scans"),
        ({"restart": 8}, (2000, 100_000), "of 2 .*complete"),
    ],
)
def test_jpeg_parts_that_cannot_be_decoded_are_refused(
    params: dict[str, int], gap: tuple[int, int], words: str
) -> None:
    codec = Jpeg.create(**params)
    bitstream = codec.encode(PICTURE)
    with pytest.raises(BitstreamError, match=words):
        codec.decode_partial(without(bitstream, (gap[0], min(gap[1], len(bitstream)))))


def test_markers_out_of_order_are_damage() -> None:
    bitstream = bytearray(Jpeg.create(restart=1).encode(GRAY))
    mark = restarts(bytes(bitstream))[4]
    bitstream[mark + 1] = 0xD0
    with pytest.raises(BitstreamError, match="out of order"):
        salvage([Fragment(0, bytes(bitstream))], "jpeg")


@pytest.mark.parametrize("image", [PICTURE, GRAY], ids=["rgb", "gray"])
def test_jpeg2000_becomes_finer_with_each_byte_that_comes(image: np.ndarray) -> None:
    codec = Jpeg2000.create(ratio=15)
    bitstream = codec.encode(image)
    errors = []
    for share in (0.2, 0.5, 0.8):
        cut = int(share * len(bitstream))
        found = codec.decode_partial(without(bitstream, (cut, len(bitstream))))
        assert found.image.shape == image.shape
        assert not found.whole.any()
        errors.append(np.square(found.image.astype(float) - image).mean())
    whole = codec.decode_partial([Fragment(0, bitstream)])
    assert whole.whole.all()
    errors.append(np.square(whole.image.astype(float) - image).mean())
    assert errors == sorted(errors, reverse=True)
    behind = codec.decode_partial(without(bitstream, (cut, cut + 50)))
    assert np.array_equal(behind.image, found.image)
    with pytest.raises(BitstreamError, match="box at byte 0"):
        codec.decode_partial(without(bitstream, (0, 100)))


def test_openjpeg_is_strict_again_afterwards() -> None:
    codec = Jpeg2000.create(ratio=15)
    bitstream = codec.encode(GRAY)
    before = codec._glymur.lib.openjp2.setup_decoder
    codec.decode_partial([Fragment(0, bitstream[:900])])
    assert codec._glymur.lib.openjp2.setup_decoder is before


def test_slices_of_multilevel_outlive_each_other() -> None:
    codec = Multilevel.create(profile="context", qf=3, restart=2, effort="fast")
    bitstream = codec.encode(GRAY)
    found = codec.decode_partial(without(bitstream, (len(bitstream) // 2, len(bitstream) // 2 + 10)))
    assert 0.6 < found.whole.mean() < 1.0
    assert np.array_equal(found.image[found.whole], codec.decode(bitstream)[found.whole])
    plain = Multilevel.create(profile="context", qf=3, effort="fast")
    with pytest.raises(BitstreamError, match="no restart points"):
        plain.decode_partial([Fragment(0, plain.encode(GRAY)[:1500])])


def test_other_codecs_have_no_such_thing() -> None:
    with pytest.raises(Unsupported, match=r"^png cannot decode"):
        Png.create().decode_partial([Fragment(0, b"")])
