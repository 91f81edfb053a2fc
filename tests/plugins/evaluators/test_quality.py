"""Quality metrics against scikit-image, scipy, the formulas written out, and values known in closed form."""

from __future__ import annotations

import itertools
import math
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from memory_sequence import CodedInMemory, FunctionCodec, MemorySequence, context, jpeg, textured
from scipy.ndimage import correlate1d
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from codecbench.core.contracts.evaluator import CodedFrame
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.sequence import Depth, Frame
from codecbench.plugins.evaluators.fidelity import (
    SCALE_WEIGHTS,
    gaussian_window,
    multiscale_similarity,
    psnr_db,
    similarity,
)
from codecbench.plugins.evaluators.quality import Quality


def pairs() -> list[tuple[Image, Image]]:
    """Pictures beside what is left of them: natural damage, noise, opposites, odd shapes."""
    rng = np.random.default_rng(5)
    texture = textured(97, 131)
    noise = rng.integers(0, 256, (40, 53), dtype=np.uint8)
    return [
        (texture, jpeg(texture, 10)),
        (texture, np.asarray(cv2.GaussianBlur(texture, (0, 0), 2.0), dtype=np.uint8)),
        (texture, np.asarray(255 - texture, dtype=np.uint8)),
        (noise, rng.integers(0, 256, noise.shape, dtype=np.uint8)),
        (textured(11, 11), jpeg(textured(11, 11), 5)),
        (np.zeros((30, 20), np.uint8), np.full((30, 20), 255, np.uint8)),
    ]


def formula_maps(gray: Image, other: Image) -> tuple[np.ndarray, np.ndarray]:
    """SSIM and contrast x structure per pixel, straight from the definition, by scipy's filters."""
    half = gaussian_window()
    weights = np.concatenate([half[:0:-1], half])

    def windowed(values: np.ndarray) -> np.ndarray:
        return correlate1d(correlate1d(values, weights, axis=0, mode="nearest"), weights, axis=1, mode="nearest")

    x, y = gray.astype(np.float64), other.astype(np.float64)
    mean_x, mean_y = windowed(x), windowed(y)
    variance_x, variance_y = windowed(x * x) - mean_x**2, windowed(y * y) - mean_y**2
    covariance = windowed(x * y) - mean_x * mean_y
    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    contrast = (2 * covariance + c2) / (variance_x + variance_y + c2)
    return (2 * mean_x * mean_y + c1) / (mean_x**2 + mean_y**2 + c1) * contrast, contrast


@pytest.mark.parametrize(("gray", "other"), pairs())
def test_ssim_of_both_borders_is_the_formula(gray: Image, other: Image) -> None:
    ssim, contrast = formula_maps(gray, other)
    found = similarity(gray, other)
    assert found.full == pytest.approx(ssim.mean(), abs=1e-12)
    assert found.inner == pytest.approx(ssim[5:-5, 5:-5].mean(), abs=1e-12)
    assert found.contrast_structure == pytest.approx(contrast[5:-5, 5:-5].mean(), abs=1e-12)


@pytest.mark.parametrize(("gray", "other"), pairs())
def test_ssim_wang_is_scikit_image(gray: Image, other: Image) -> None:
    expected = structural_similarity(
        gray, other, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=255
    )
    assert similarity(gray, other).inner == pytest.approx(expected, abs=1e-12)


def test_the_window_sums_to_one_and_is_gaussian() -> None:
    half = gaussian_window()
    assert len(half) == 6
    assert half[0] + 2 * half[1:].sum() == pytest.approx(1.0, abs=1e-15)
    np.testing.assert_allclose(half[1:] / half[0], np.exp(-(np.arange(1, 6) ** 2) / 4.5), rtol=1e-14)


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (7, 1), (3, 5), (10, 40), (40, 10), (11, 11)])
def test_small_pictures_follow_the_brute_force_definition(shape: tuple[int, int], rng: np.random.Generator) -> None:
    gray, other = (rng.integers(0, 256, shape, dtype=np.uint8) for _ in range(2))
    half = gaussian_window()
    total = 0.0
    for row, column in np.ndindex(shape):
        sums = np.zeros(5)
        for down, along in itertools.product(range(-5, 6), repeat=2):
            at = min(max(row + down, 0), shape[0] - 1), min(max(column + along, 0), shape[1] - 1)
            x, y = float(gray[at]), float(other[at])
            sums += half[abs(down)] * half[abs(along)] * np.array([x, y, x * x, y * y, x * y])
        c1, c2 = 6.5025, 58.5225
        luminance = (2 * sums[0] * sums[1] + c1) / (sums[0] ** 2 + sums[1] ** 2 + c1)
        variances = sums[2] - sums[0] ** 2 + sums[3] - sums[1] ** 2
        total += luminance * (2 * (sums[4] - sums[0] * sums[1]) + c2) / (variances + c2)
    found = similarity(gray, other)
    assert found.full == pytest.approx(total / gray.size, abs=1e-11)
    assert math.isnan(found.inner) == (min(shape) < 11)


def test_constant_pictures_have_the_luminance_term_alone() -> None:
    first, second = np.full((200, 200), 50, np.uint8), np.full((200, 200), 100, np.uint8)
    expected = (2 * 50 * 100 + 6.5025) / (50**2 + 100**2 + 6.5025)
    found = similarity(first, second)
    assert found.full == pytest.approx(expected, abs=1e-12)
    assert found.inner == pytest.approx(expected, abs=1e-12)
    assert multiscale_similarity(first, second, found) == pytest.approx(expected ** SCALE_WEIGHTS[-1], abs=1e-10)


@pytest.mark.parametrize("shape", [(176, 176), (191, 250)])
def test_ms_ssim_is_the_product_over_scales(shape: tuple[int, int]) -> None:
    gray = textured(*shape)
    other = jpeg(gray, 8)
    x, y, expected = gray.astype(np.float64), other.astype(np.float64), 1.0
    for scale, weight in enumerate([0.0448, 0.2856, 0.3001, 0.2363, 0.1333]):
        ssim, contrast = formula_maps(x, y)
        expected *= (ssim if scale == 4 else contrast)[5:-5, 5:-5].mean() ** weight
        height, width = x.shape[0] // 2 * 2, x.shape[1] // 2 * 2
        x, y = (p[:height, :width].reshape(height // 2, 2, width // 2, 2).mean(axis=(1, 3)) for p in (x, y))
    assert multiscale_similarity(gray, other, similarity(gray, other)) == pytest.approx(expected, abs=1e-11)


def test_ms_ssim_of_opposites_is_zero_and_of_equals_one() -> None:
    gray = textured(180, 200)
    opposite = np.asarray(255 - gray, dtype=np.uint8)
    assert multiscale_similarity(gray, opposite, similarity(gray, opposite)) == 0.0
    assert multiscale_similarity(gray, gray, similarity(gray, gray)) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("shape", [(64, 48), (64, 48, 3), (1, 1)])
def test_psnr_is_scikit_image(shape: tuple[int, ...], rng: np.random.Generator) -> None:
    first, second = (rng.integers(0, 256, shape, dtype=np.uint8) for _ in range(2))
    assert psnr_db(first, second) == pytest.approx(peak_signal_noise_ratio(first, second), abs=1e-10)


def test_16_bits_have_their_own_peak(rng: np.random.Generator, tmp_path: Path) -> None:
    first, second = (rng.integers(0, 65536, (64, 48), dtype=np.uint16) for _ in range(2))
    assert psnr_db(first, second) == pytest.approx(peak_signal_noise_ratio(first, second), abs=1e-9)
    sequence = MemorySequence([first])
    coded = CodedInMemory(sequence, FunctionCodec(lambda image: second))
    values = {found.metric: found for found in Quality.create().evaluate(coded, context(tmp_path))}
    expected = structural_similarity(
        first, second, data_range=65535, gaussian_weights=True, sigma=1.5, use_sample_covariance=False
    )
    assert values["ssim_wang"].value == pytest.approx(expected, abs=1e-9)
    assert values["rate_bpp"].value == 16.0
    assert values["compression_ratio"].value == 1.0
    depth = CodedInMemory(MemorySequence([first], depth=Depth(0.001)), FunctionCodec(lambda image: second))
    values = {found.metric: found for found in Quality.create().evaluate(depth, context(tmp_path))}
    assert math.isnan(values["psnr_gray_db"].value)
    assert "distances" in values["psnr_gray_db"].reason
    assert values["rate_bpp"].value == 16.0


def test_psnr_in_closed_form() -> None:
    black = np.zeros((48, 64), np.uint8)
    assert psnr_db(black, np.full_like(black, 255)) == pytest.approx(0.0, abs=1e-12)
    assert psnr_db(black, np.full_like(black, 1)) == pytest.approx(20 * math.log10(255), abs=1e-12)
    assert psnr_db(black, black) == math.inf
    one_off = black.copy()
    one_off[3, 4] = 1
    assert psnr_db(black, one_off) == pytest.approx(20 * math.log10(255) + 10 * math.log10(48 * 64), abs=1e-12)


def measured(images: list[Image], codec: FunctionCodec, folder: Path) -> dict[tuple[str, int | None], float]:
    coded = CodedInMemory(MemorySequence(images), codec)
    return {(m.metric, m.frame): m.value for m in Quality.create().evaluate(coded, context(folder))}


def test_rates_in_closed_form(tmp_path: Path) -> None:
    gray = textured(20, 30)
    color = np.ascontiguousarray(np.dstack([gray, gray.T.reshape(20, 30), gray]))
    values = measured([color], FunctionCodec(), tmp_path)
    assert values["size_bytes", 0] == 1800
    assert values["rate_bpp", 0] == 24
    assert values["bitrate_kbps", 0] == pytest.approx(1800 * 8 * 10 / 1000)
    assert values["compression_ratio", 0] == 1
    png = len(cv2.imencode(".png", color[..., ::-1])[1])
    assert values["cr_percent", 0] == pytest.approx(100 * (1 - 1800 / png))


def test_each_frame_has_every_metric_and_gray_frames_no_rgb(tmp_path: Path) -> None:
    names = {metric.name for metric in Quality.metrics}
    gray = [textured(180, 190, seed) for seed in range(3)]
    values = measured(gray, FunctionCodec(lambda image: jpeg(image, 20)), tmp_path)
    assert set(values) == {(name, frame) for name in names - {"psnr_rgb_db"} for frame in range(3)}
    color = [np.dstack([gray[0], gray[1], gray[2]])]
    values = measured(color, FunctionCodec(lambda image: jpeg(image, 20)), tmp_path)
    assert {name for name, _ in values} == names
    assert all(math.isfinite(value) for value in values.values())


def test_scores_of_color_are_of_bt601_gray(tmp_path: Path, rng: np.random.Generator) -> None:
    color = rng.integers(0, 256, (30, 40, 3), dtype=np.uint8)
    other = jpeg(color, 30)
    values = measured([color], FunctionCodec(lambda _: other), tmp_path)
    first, second = (np.rint(picture @ [0.299, 0.587, 0.114]) for picture in (color, other))
    assert values["psnr_gray_db", 0] == pytest.approx(peak_signal_noise_ratio(first, second, data_range=255), abs=0.02)


def test_missing_values_say_why(tmp_path: Path) -> None:
    coded = CodedInMemory(MemorySequence([np.zeros((1, 1), np.uint8)]))
    found = {m.metric: m for m in Quality.create().evaluate(coded, context(tmp_path))}
    assert found["ssim_matlab"].value == 1.0
    assert found["psnr_gray_db"].value == math.inf
    for name, side in (("ssim_wang", 11), ("ms_ssim", 176)):
        assert math.isnan(found[name].value)
        assert re.findall(r"\d+x\d+", str(found[name].reason)) == ["1x1", f"{side}x{side}"]


def test_real_frames(data_folder: Path) -> None:
    path = sorted((data_folder / "fr3_png16" / "rgb").glob("*.png"))[0]
    image = np.ascontiguousarray(cv2.imread(str(path), cv2.IMREAD_COLOR)[..., ::-1])
    gray = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))
    decoded = jpeg(gray, 10)
    expected = structural_similarity(
        gray, decoded, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=255
    )
    found = similarity(gray, decoded)
    assert found.inner == pytest.approx(expected, abs=1e-12)
    assert abs(found.full - found.inner) < 0.01
    coded = CodedFrame(Frame(0, 0.0, image), b"x" * 1000, image)
    assert coded.original.png_size_bytes == pytest.approx(472_000, rel=0.15)
