"""The shared block transform against definitions, scipy, OpenCV and T.81's own tables."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.fft import dctn

from codecbench.core.contracts.image import gray_from_image
from codecbench.plugins.codecs.dct import tables
from codecbench.plugins.codecs.dct.blocks import (
    blocks_from_plane,
    dequantise,
    inverse_zigzag,
    plane_from_blocks,
    quantise,
    zigzag,
)
from codecbench.plugins.codecs.dct.planes import (
    crop_plane,
    image_from_planes,
    pad_plane,
    plane_shapes,
    planes_from_image,
)
from codecbench.plugins.codecs.dct.transform import forward_dct, inverse_dct

COLORS = ("gray", "rgb", "ycbcr444", "ycbcr420")


def transformed(plane: np.ndarray, shift: float = 0.0) -> np.ndarray:
    coefficients = np.empty((plane.size // 64, 64), np.float32)
    forward_dct(plane, np.float32(shift), coefficients)
    return coefficients


def blocks_of(plane: np.ndarray) -> np.ndarray:
    height, width = plane.shape
    return plane.reshape(height // 8, 8, width // 8, 8).swapaxes(1, 2).reshape(-1, 8, 8).astype(np.float64)


def test_zigzag_starts_and_ends_as_in_figure_a6() -> None:
    assert tables.ZIGZAG[:10].tolist() == [0, 1, 8, 16, 9, 2, 3, 10, 17, 24]
    assert tables.ZIGZAG[-6:].tolist() == [61, 54, 47, 55, 62, 63]
    assert sorted(tables.ZIGZAG) == list(range(64))


def test_tables_k1_and_k2_are_what_libjpeg_writes_at_quality_50() -> None:
    done, stream = cv2.imencode(".jpg", np.zeros((16, 16, 3), np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 50])
    assert done
    data = stream.tobytes()
    for number, table in enumerate((tables.LUMINANCE, tables.CHROMINANCE)):
        start = data.index(bytes((0xFF, 0xDB, 0, 67, number))) + 5
        assert list(data[start : start + 64]) == table.reshape(64)[tables.ZIGZAG].tolist()


def test_the_papers_table_has_ones_in_its_first_six_places() -> None:
    scanned = tables.PAPER.reshape(64)[tables.ZIGZAG]
    assert scanned[:6].tolist() == [1] * 6
    assert np.array_equal(scanned[6:], tables.LUMINANCE.reshape(64)[tables.ZIGZAG][6:])


@pytest.mark.parametrize("shift", [0.0, 128.0])
def test_forward_transform_agrees_with_scipy(rng: np.random.Generator, shift: float) -> None:
    plane = rng.integers(0, 256, (40, 56), dtype=np.uint8)
    expected = dctn(blocks_of(plane) - shift, axes=(1, 2), norm="ortho").reshape(-1, 64)
    assert np.abs(transformed(plane, shift) - expected).max() < 5e-4


def test_forward_transform_agrees_with_the_definition(rng: np.random.Generator) -> None:
    plane = rng.integers(0, 256, (8, 8), dtype=np.uint8)
    expected = np.zeros((8, 8))
    for v in range(8):
        for u in range(8):
            scale = 0.25 * (np.sqrt(0.5) if u == 0 else 1) * (np.sqrt(0.5) if v == 0 else 1)
            for y in range(8):
                for x in range(8):
                    wave = np.cos((2 * x + 1) * u * np.pi / 16) * np.cos((2 * y + 1) * v * np.pi / 16)
                    expected[v, u] += scale * plane[y, x] * wave
    assert np.abs(transformed(plane).reshape(8, 8) - expected).max() < 5e-4


def test_dc_is_exactly_an_eighth_of_the_sum(rng: np.random.Generator) -> None:
    plane = rng.integers(0, 256, (64, 64), dtype=np.uint8)
    assert np.array_equal(transformed(plane)[:, 0], blocks_of(plane).sum(axis=(1, 2)) / 8)


def test_inverse_of_forward_is_the_plane(rng: np.random.Generator) -> None:
    for plane in (rng.integers(0, 256, (64, 72), dtype=np.uint8), np.full((8, 8), 255, np.uint8)):
        back = np.empty_like(plane)
        inverse_dct(transformed(plane, 128), np.float32(128), back)
        assert np.array_equal(back, plane)


def test_inverse_clamps_and_rounds_halves_up() -> None:
    coefficients = np.zeros((4, 64), np.float32)
    coefficients[:, 0] = 8 * np.array([-3.0, 300.0, 100.5, 100.4375])
    plane = np.empty((8, 32), np.uint8)
    inverse_dct(coefficients, np.float32(0), plane)
    assert plane[0, ::8].tolist() == [0, 255, 101, 100]


@given(
    hnp.arrays(np.float32, (2, 64), elements=st.floats(-2048, 2048, width=32)),
    st.floats(0.0625, 300, width=32),
)
@settings(max_examples=60)
def test_quantiser_rounds_half_away_from_zero(coefficients: np.ndarray, step: float) -> None:
    steps = np.full(64, step, np.float32)
    indices = np.empty((2, 64), np.int32)
    quantise(coefficients, steps, indices)
    ratio = (coefficients / steps).astype(np.float64)
    assert np.array_equal(indices, np.sign(ratio) * np.floor(np.abs(ratio) + 0.5))


def test_quantiser_on_ties_and_their_neighbours() -> None:
    half = np.float32(0.5)
    below = np.nextafter(half, np.float32(0))
    values = np.array([half, -half, below, -below, 1.5, -1.5, 2.5, -2.5, 0, 4194304.5], np.float32)
    coefficients = np.zeros((1, 64), np.float32)
    coefficients[0, : len(values)] = values
    indices = np.empty((1, 64), np.int32)
    quantise(coefficients, np.ones(64, np.float32), indices)
    assert indices[0, : len(values)].tolist() == [1, -1, 0, 0, 2, -2, 3, -3, 0, 4194305]


def test_dequantiser_multiplies(rng: np.random.Generator) -> None:
    indices = rng.integers(-500, 500, (3, 64), dtype=np.int32)
    steps = tables.steps_from_table(tables.PAPER, 5)
    coefficients = np.empty((3, 64), np.float32)
    dequantise(indices, steps, coefficients)
    assert np.array_equal(coefficients, indices.astype(np.float32) * steps)


def test_zigzag_and_back(rng: np.random.Generator) -> None:
    natural = rng.integers(-9, 9, (5, 64), dtype=np.int32)
    scanned, back = np.empty_like(natural), np.empty_like(natural)
    zigzag(natural, scanned)
    inverse_zigzag(scanned, back)
    assert np.array_equal(scanned, natural[:, tables.ZIGZAG])
    assert np.array_equal(back, natural)


def test_stripes_do_not_show(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    plane = rng.integers(0, 256, (72, 40), dtype=np.uint8)
    steps = tables.steps_from_table(tables.PAPER, 5)
    whole = blocks_from_plane(plane, steps)
    decoded = plane_from_blocks(whole, plane.shape, steps)
    monkeypatch.setattr("codecbench.plugins.codecs.dct.blocks._STRIPE_BLOCKS", 11)
    assert np.array_equal(blocks_from_plane(plane, steps), whole)
    assert np.array_equal(plane_from_blocks(whole, plane.shape, steps), decoded)


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (13, 8), (8, 16), (7, 23)])
def test_padding_repeats_the_edge(rng: np.random.Generator, shape: tuple[int, int]) -> None:
    plane = rng.integers(0, 256, shape, dtype=np.uint8)
    rows, columns = (-size % 8 for size in shape)
    larger = pad_plane(plane)
    assert np.array_equal(larger, np.pad(plane, ((0, rows), (0, columns)), "edge"))
    assert np.array_equal(crop_plane(larger, shape), plane)


@pytest.mark.parametrize("color", COLORS)
@pytest.mark.parametrize("shape", [(1, 1), (1, 6), (5, 1), (7, 11)])
def test_plane_shapes_are_those_of_the_planes(rng: np.random.Generator, color, shape) -> None:  # type: ignore[no-untyped-def]
    image = rng.integers(0, 256, (*shape, 3), dtype=np.uint8)
    planes = planes_from_image(image, color)
    assert [plane.shape for plane in planes] == plane_shapes(*shape, color)
    assert image_from_planes(planes, color, 3).shape == image.shape


def test_a_gray_image_is_one_plane_in_every_color_space(rng: np.random.Generator) -> None:
    image = rng.integers(0, 256, (9, 9), dtype=np.uint8)
    for color in COLORS:
        (plane,) = planes_from_image(image, color)
        assert np.array_equal(plane, image)


def test_rgb_planes_are_the_channels(rng: np.random.Generator) -> None:
    image = rng.integers(0, 256, (9, 7, 3), dtype=np.uint8)
    planes = planes_from_image(image, "rgb")
    assert np.array_equal(np.dstack(planes), image)
    assert np.array_equal(image_from_planes(planes, "rgb", 3), image)


def test_luma_is_the_gray_that_scores_use(rng: np.random.Generator) -> None:
    image = rng.integers(0, 256, (300, 300, 3), dtype=np.uint8)
    assert np.array_equal(planes_from_image(image, "gray")[0], gray_from_image(image))


def test_chroma_is_jfifs(rng: np.random.Generator) -> None:
    image = rng.integers(0, 256, (64, 64, 3), dtype=np.uint8)
    red, green, blue = (image[..., channel].astype(np.float64) for channel in range(3))
    _, cb, cr = planes_from_image(image, "ycbcr444")
    assert np.abs(cb - np.clip(128 - 0.168736 * red - 0.331264 * green + 0.5 * blue, 0, 255)).max() < 0.51
    assert np.abs(cr - np.clip(128 + 0.5 * red - 0.418688 * green - 0.081312 * blue, 0, 255)).max() < 0.51


def test_ycbcr_444_comes_back_within_a_rounding(rng: np.random.Generator) -> None:
    image = rng.integers(0, 256, (64, 64, 3), dtype=np.uint8)
    back = image_from_planes(planes_from_image(image, "ycbcr444"), "ycbcr444", 3)
    assert np.abs(back.astype(int) - image).max() <= 2


def test_420_of_a_smooth_picture_comes_back(rng: np.random.Generator) -> None:
    row, column = np.mgrid[:33, :47]
    image = np.dstack([row * 4, column * 4, 200 - row - column]).astype(np.uint8)
    back = image_from_planes(planes_from_image(image, "ycbcr420"), "ycbcr420", 3)
    assert np.abs(back.astype(int) - image)[2:-2, 2:-2].max() <= 3
