"""The codec as a whole: what does not change the pixels, what sizes it reaches, and what it refuses."""

from __future__ import annotations

import threading
from itertools import product
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from multilevel_pictures import textured
from pydantic import ValidationError
from scipy.fft import dctn, idctn

from codecbench.core.contracts.errors import KeyCollision, ParamsError
from codecbench.core.contracts.image import gray_from_image
from codecbench.core.counting.trace import CountingTrace
from codecbench.plugins.codecs.dct.tables import LUMINANCE, PAPER, ZIGZAG
from codecbench.plugins.codecs.multilevel import Multilevel, describe

GOOD_KEYS = (0.1234567891, 0.52345678987, 0.87987654321)

PAPER_TABLE_3_KIB = {5: 95.5, 10: 74.5, 15: 64.0, 20: 59.0, 50: 40.0, 75: 32.0, 100: 28.0}
"""Mean of frames 1132 and 2398, one level (Salih & Vasarhelyi, table 3)."""


def round_trip(image: np.ndarray, **setting: object) -> np.ndarray:
    """Decoded by another instance, at other parameters."""
    return Multilevel.create(qf=33).decode(Multilevel.create(**setting).encode(image))


def expected_gray(image: np.ndarray, table: np.ndarray, qf: float) -> np.ndarray:
    """The definition: scipy's DCT, halves away from zero, no level shift."""
    height, width = image.shape
    rows, columns = -(-height // 8), -(-width // 8)
    larger = np.pad(image, ((0, rows * 8 - height), (0, columns * 8 - width)), "edge")
    blocks = larger.reshape(rows, 8, columns, 8).swapaxes(1, 2).astype(np.float64)
    steps = table * qf
    ratio = dctn(blocks, axes=(2, 3), norm="ortho") / steps
    indices = np.sign(ratio) * np.floor(np.abs(ratio) + 0.5)
    back = idctn(indices * steps, axes=(2, 3), norm="ortho")
    plane = back.swapaxes(1, 2).reshape(rows * 8, columns * 8)[:height, :width]
    return np.floor(np.clip(plane, 0, 255) + 0.5)


@pytest.mark.parametrize("qf", [1, 5, 20.5, 100])
def test_pixels_are_those_of_the_definition(qf: float) -> None:
    image = textured(61, 77)
    difference = np.abs(round_trip(image, qf=qf) - expected_gray(image, PAPER, qf))
    # A coefficient half way between two indices, or a sample half way between two levels, may fall either side.
    assert (difference > 0).mean() < 1e-3
    image_at_standard = round_trip(image, qf=qf, table="standard")
    assert (np.abs(image_at_standard - expected_gray(image, LUMINANCE, qf)) > 0).mean() < 1e-3


def test_levels_decoding_keys_groups_and_scans_leave_the_pixels_alone() -> None:
    for image in (textured(37, 50), textured(37, 50, 3)):
        expected = round_trip(image)
        for levels, decoding, keys, scan in product(
            (1, 2, 3), ("header", "search"), ("canonical", "random"), ("block", "coefficient")
        ):
            got = round_trip(image, levels=levels, decoding=decoding, keys=keys, scan=scan, seed=levels)
            assert np.array_equal(got, expected), (levels, decoding, keys, scan)
        for group in (2, 4, 5):
            assert np.array_equal(round_trip(image, group=group, levels=2), expected)
        assert np.array_equal(round_trip(image, keys=GOOD_KEYS), expected)
        assert np.array_equal(round_trip(image, keys=GOOD_KEYS, decoding="search"), expected)


@given(
    shape=st.tuples(st.integers(1, 30), st.integers(1, 30)),
    channels=st.sampled_from([1, 3]),
    color=st.sampled_from(["gray", "rgb", "ycbcr444", "ycbcr420"]),
    levels=st.integers(1, 16),
    group=st.integers(2, 4),
    decoding=st.sampled_from(["header", "search"]),
    scan=st.sampled_from(["block", "coefficient"]),
    qf=st.floats(0.5, 1000),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=80)
def test_noise_of_any_size_keeps_its_shape(  # type: ignore[no-untyped-def]
    shape, channels, color, levels, group, decoding, scan, qf, seed
) -> None:
    image = np.random.default_rng(seed).integers(0, 256, (*shape, 3)[: 2 + channels // 3], dtype=np.uint8)
    setting = {"color": color, "qf": qf}
    expected = round_trip(image, **setting)
    assert expected.shape == image.shape
    got = round_trip(image, **setting, levels=levels, group=group, decoding=decoding, scan=scan, keys="random")
    assert np.array_equal(got, expected)


@pytest.mark.parametrize("keys", ["canonical", "random", GOOD_KEYS])
def test_all_searches_decode_the_same(keys: object) -> None:
    stream = Multilevel.create(qf=60, decoding="search", keys=keys).encode(textured(24, 24))
    images = [Multilevel.create(search=search).decode(stream) for search in ("sequential", "pruned", "greedy")]
    assert np.array_equal(images[0], images[1])
    assert np.array_equal(images[0], images[2])


def test_color_of_a_gray_image_does_not_matter() -> None:
    image = textured(20, 30)
    streams = {Multilevel.create(color=color).encode(image) for color in ("gray", "rgb", "ycbcr444", "ycbcr420")}
    assert len(streams) == 1


def test_gray_coding_of_a_color_image_is_that_of_its_gray_picture() -> None:
    image = textured(20, 30, 3)
    decoded = round_trip(image, color="gray")
    assert decoded.shape == image.shape
    assert np.array_equal(decoded, np.dstack([round_trip(gray_from_image(image))] * 3))


def test_chroma_is_shifted_and_luma_is_not() -> None:
    gray = np.full((16, 16, 3), 100, np.uint8)
    assert np.array_equal(round_trip(gray, color="ycbcr444"), gray)
    assert describe(Multilevel.create(color="ycbcr444").encode(gray)).entries == (
        4,
    )  # zeros, and a luma DC in each place


def test_manual_keys_that_collide_are_refused() -> None:
    image = textured(64, 64)
    with pytest.raises(KeyCollision, match=r"level 1: .*\(\d+, .*\) and \(\d+, .* search"):
        Multilevel.create(keys=(0.31, 0.52, 0.87), decoding="search").encode(image)
    with pytest.raises(KeyCollision, match=r"level 1: .*\(\d+, .*\) and \(\d+, "):
        Multilevel.create(keys=(0.25, 0.5, 0.75)).encode(image)


def test_codes_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ParamsError, match="lower `group`"):
        Multilevel.create(group=12, qf=1).encode(textured(64, 64))


@pytest.mark.parametrize(
    "wrong",
    [
        {"qf": 0},
        {"qf": -5},
        {"qf": float("nan")},
        {"levels": 0},
        {"group": 1},
        {"keys": (0.5, 0.25)},
        {"keys": (0.5, 0.25, 1.0)},
        {"keys": "golden"},
        {"table": (1,) * 63},
        {"table": (0,) * 64},
        {"seed": -1},
        {"quality": 5},
    ],
)
def test_wrong_parameters_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        Multilevel.create(**wrong)


@pytest.mark.thorough
def test_counting_gives_the_same_bytes_and_pixels() -> None:
    image = textured(24, 32, 3)
    for setting in ({}, {"levels": 2, "decoding": "search", "color": "ycbcr420", "scan": "coefficient"}):
        codec = Multilevel.create(**setting)
        encoding, decoding = CountingTrace(), CountingTrace()
        stream = codec.encode(image, trace=encoding)
        assert stream == codec.encode(image)
        assert np.array_equal(codec.decode(stream, trace=decoding), codec.decode(stream))
        assert {"dct", "quantization", "minimization", "arithmetic_coding"} <= set(encoding.counts)
        assert {"arithmetic_decoding", "dequantization", "idct"} <= set(decoding.counts)


@pytest.mark.thorough
def test_minimisation_is_counted_as_the_paper_counts_it() -> None:
    trace = CountingTrace()
    Multilevel.create().encode(textured(48, 48), trace=trace)
    counts = trace.counts["minimization"]
    samples = 48 * 48
    assert samples <= counts.mults < samples + 16
    assert samples <= counts.reads < samples + 16
    assert counts.writes == samples // 3


def test_threads_do_not_disturb_one_another() -> None:
    images = [textured(96, 96 + 8 * number, 3) for number in range(4)]
    codec = Multilevel.create(levels=2, decoding="search")
    expected = [codec.encode(image) for image in images]
    wrong: list[int] = []

    def work(number: int) -> None:
        for _ in range(5):
            stream = codec.encode(images[number])
            if stream != expected[number] or codec.decode(stream).shape != images[number].shape:
                wrong.append(number)

    threads = [threading.Thread(target=work, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


def frames(data_folder: Path, count: int) -> list[np.ndarray]:
    paths = sorted((data_folder / "fr3_png16" / "rgb").glob("*.png"))[:count]
    return [cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB) for path in paths]


@pytest.mark.real
@pytest.mark.parametrize("qf", sorted(PAPER_TABLE_3_KIB))
def test_sizes_are_within_12_percent_of_the_papers(data_folder: Path, qf: int) -> None:
    codec = Multilevel.create(qf=qf)
    sizes = [len(codec.encode(image)) / 1024 for image in frames(data_folder, 4)]
    assert abs(np.mean(sizes) / PAPER_TABLE_3_KIB[qf] - 1) < 0.12


@pytest.mark.real
@pytest.mark.parametrize("qf", [5, 100])
def test_payload_is_within_a_thousandth_of_its_entropy(data_folder: Path, qf: int) -> None:
    (image,) = frames(data_folder, 1)
    for picture in (image, gray_from_image(image)):
        planes = picture.reshape(480, 640, -1)
        ratios = [
            dctn(planes[..., k].reshape(60, 8, 80, 8).swapaxes(1, 2).astype(float), axes=(2, 3), norm="ortho")
            / (PAPER * qf)
            for k in range(planes.shape[2])
        ]
        indices = np.stack([np.sign(r) * np.floor(np.abs(r) + 0.5) for r in ratios]).reshape(-1, 64)[:, ZIGZAG]
        counts = np.unique(indices.reshape(-1, 3), axis=0, return_counts=True)[1]
        entropy = -(counts * np.log2(counts / counts.sum())).sum() / 8
        assert describe(Multilevel.create(qf=qf).encode(picture)).payload < entropy * 1.001
