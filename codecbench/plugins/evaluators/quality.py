"""The `quality` evaluator measures the rate and the fidelity of each frame."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from codecbench.core.contracts.evaluator import CodedFrame, CodedSequence, Context, Measurement, SequenceEvaluator
from codecbench.core.contracts.image import Image, channel_count, gray_from_image
from codecbench.core.contracts.metric import Metric
from codecbench.core.contracts.params import NoParams
from codecbench.core.contracts.sequence import Frame
from codecbench.plugins.evaluators.fidelity import (
    MULTISCALE_SIDE,
    PEAK,
    WINDOW_SIDE,
    multiscale_similarity,
    psnr_db,
    similarity,
)


class Quality(SequenceEvaluator[NoParams]):
    """Rate, PSNR and structural similarity of every frame. docs/metrics.md defines each metric.

    Feature codecs have a rate only, because no image is decoded, and so have depth sequences: an error of a distance
    means nothing as a share of the largest one that 16 bits can store.
    """

    name = "quality"
    version = "2"
    bits = (8, 16)
    kernels = ("codecbench.plugins.evaluators.fidelity",)
    params_type = NoParams
    typical_ms_per_frame = 30.0
    metrics: ClassVar[tuple[Metric, ...]] = (
        Metric(
            "size_bytes", "bytes", "lower", "the whole bitstream, headers included",
            role="rate", label="size", scale="log",
        ),
        Metric(
            "rate_bpp", "bit/px", "lower", "bits per pixel, all channels together",
            role="rate", headline=True, label="rate", column_header="bpp", scale="log", quantity="per_pixel",
        ),
        Metric(
            "bitrate_kbps", "kbit/s", "lower", "the frame's bits times the nominal frame rate",
            role="rate", label="bit rate", scale="log",
        ),
        Metric(
            "compression_ratio", "1", "higher", "raw bytes of all channels over bitstream bytes",
            role="rate",
        ),
        Metric(
            "cr_percent", "%", "higher", "100 (1 - size_bytes / bytes of the frame's PNG)",
            role="rate", headline=True, label="size against PNG", column_header="vs\nPNG %", display_factor=-1.0,
            quantity="below_png",
        ),
        Metric(
            "psnr_gray_db", "dB", "higher", "10 log10(peak^2 / MSE) of gray, with a peak of 255, or 65535 of 16 bits",
            role="quality", headline=True, label="PSNR", column_header="PSNR dB", enough=40.0,
        ),
        Metric(
            "psnr_rgb_db", "dB", "higher", "PSNR over three channels; color frames only",
            role="quality", label="PSNR of color",
        ),
        Metric(
            "ssim_matlab", "1", "higher", "mean SSIM of gray, border replicated, as MATLAB's ssim",
            role="quality", headline=True, label="SSIM", enough=0.95,
        ),
        Metric(
            "ssim_wang", "1", "higher",
            "mean SSIM of gray where the window fits, as Wang's code",
            role="quality", label="SSIM inside",
        ),
        Metric("ms_ssim", "1", "higher", "five-scale SSIM of gray", role="quality", label="MS-SSIM"),
    )  # fmt: skip

    def evaluate(self, coded: CodedSequence, context: Context) -> Iterator[Measurement]:
        sequence, missing = coded.sequence, None
        if coded.codec.carries == "features":
            missing = "the codec sends features, so no image is decoded"
        elif sequence.depth is not None:
            missing = "the pixels are distances, whose errors are lengths"
        for index in range(len(coded)):
            frame = None if missing else coded.frame(index)
            original = sequence.read(index) if frame is None else frame.original
            fidelity = _no_fidelity(original.image, missing) if frame is None else _fidelity(frame)
            for name, value, reason in (*_rate(original, coded.size_bytes(index), sequence.frame_rate_hz), *fidelity):
                yield Measurement(name, value, frame=index, reason=reason)


def _rate(original: Frame, size: int, frame_rate_hz: float) -> Iterator[tuple[str, float, str | None]]:
    image = original.image
    yield "size_bytes", float(size), None
    yield "rate_bpp", 8.0 * size / (image.shape[0] * image.shape[1]), None
    yield "bitrate_kbps", 8e-3 * size * frame_rate_hz, None
    yield "compression_ratio", image.nbytes / size, None
    yield "cr_percent", 100.0 * (1.0 - size / original.png_size_bytes), None


def _no_fidelity(image: Image, reason: str | None) -> Iterator[tuple[str, float, str | None]]:
    for name in ("psnr_gray_db", "psnr_rgb_db", "ssim_matlab", "ssim_wang", "ms_ssim"):
        if name != "psnr_rgb_db" or channel_count(image) == 3:
            yield name, math.nan, reason


def _fidelity(coded: CodedFrame) -> Iterator[tuple[str, float, str | None]]:
    original, decoded = coded.original.image, coded.decoded
    gray, decoded_gray = gray_from_image(original), gray_from_image(decoded)
    yield "psnr_gray_db", psnr_db(gray, decoded_gray), None
    if channel_count(original) == 3:
        yield "psnr_rgb_db", psnr_db(original, decoded), None
    if gray.dtype == np.uint16:  # SSIM depends on values only as shares of the peak
        gray, decoded_gray = (np.ascontiguousarray(samples * (PEAK / 65535)) for samples in (gray, decoded_gray))
    finest = similarity(gray, decoded_gray)
    yield "ssim_matlab", finest.full, None
    yield "ssim_wang", finest.inner, _reason_too_small(finest.inner, gray.shape, WINDOW_SIDE)
    multiscale = multiscale_similarity(gray, decoded_gray, finest)
    yield "ms_ssim", multiscale, _reason_too_small(multiscale, gray.shape, MULTISCALE_SIDE)


def _reason_too_small(value: float, shape: tuple[int, ...], side: int) -> str | None:
    """Why a value is NaN: a frame smaller than the window; None if there is a value."""
    if not math.isnan(value):
        return None
    return f"the frame is {shape[1]}x{shape[0]}; the window needs at least {side}x{side}"
