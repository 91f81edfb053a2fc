"""The profile as a whole: quality, effort, color, restart points and counting."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest
from multilevel_pictures import textured
from pydantic import ValidationError

from codecbench import BitstreamError, Image
from codecbench.core.contracts.image import gray_from_image
from codecbench.core.counting.trace import CountingTrace
from codecbench.plugins.codecs.multilevel import Multilevel, MultilevelParams
from codecbench.plugins.codecs.multilevel.context.profile import salvage
from codecbench.plugins.evaluators.fidelity import psnr_db


def codec(**params: Any) -> Multilevel:
    return Multilevel.create(profile="context", **params)


def photograph(height: int = 96, width: int = 128, channels: int = 1) -> Image:
    """Smooth shading with edges and a little noise."""
    rows, columns = np.mgrid[:height, :width]
    rng = np.random.default_rng(9)
    planes = []
    for channel in range(channels):
        plane = 90 + 50 * np.sin(rows / 17 + channel) + 40 * (columns > 60 + 20 * np.sin(rows / 11)) + columns / 8
        planes.append(np.clip(plane + rng.normal(0, 2, plane.shape), 0, 255).astype(np.uint8))
    return planes[0] if channels == 1 else np.dstack(planes)


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (40, 1), (17, 23), (16, 16), (33, 8)])
@pytest.mark.parametrize("channels", [1, 3])
def test_every_shape_comes_back(shape: tuple[int, int], channels: int) -> None:
    image = textured(*shape, channels)
    for params in ({"color": "ycbcr444"}, {"restart": 1}, {"effort": "fast", "lapped": True, "color": "rgb"}):
        decoded = codec(qf=0.05, **params).decode(codec(qf=0.05, **params).encode(image))
        assert decoded.shape == image.shape
        if params.get("color") == "rgb" or channels == 1:
            assert psnr_db(image, decoded) > 45


def test_fine_steps_are_nearly_lossless() -> None:
    image = photograph()
    decoded = codec(qf=0.01).decode(codec(qf=0.01).encode(image))
    assert np.abs(decoded.astype(int) - image).max() <= 1


def test_more_effort_costs_fewer_bytes_for_the_same_picture() -> None:
    image = photograph(192, 256)
    sizes = {effort: len(codec(qf=1, effort=effort).encode(image)) for effort in ("fast", "normal", "best")}
    assert sizes["best"] < sizes["normal"] < sizes["fast"]


def test_it_beats_the_static_profile() -> None:
    image = photograph(192, 256)
    static = Multilevel.create(qf=1.5, table="flat", scan="coefficient", group=4)
    ours = codec(qf=1.5)
    assert len(ours.encode(image)) < 0.7 * len(static.encode(image))
    assert psnr_db(image, ours.decode(ours.encode(image))) > psnr_db(image, static.decode(static.encode(image))) - 1


def test_coarser_chroma_leaves_luma_alone() -> None:
    image = photograph(channels=3)
    fine, coarse = codec(chroma=1, qf=1), codec(chroma=4, qf=1)
    assert len(coarse.encode(image)) < len(fine.encode(image))
    luma = gray_from_image(image)
    lumas = [psnr_db(luma, gray_from_image(c.decode(c.encode(image)))) for c in (fine, coarse)]
    assert abs(lumas[0] - lumas[1]) < 1


@pytest.mark.parametrize(
    ("color", "lapped", "beyond"),
    [("ycbcr420", True, 10), ("ycbcr444", True, 4), ("rgb", True, 4), ("ycbcr420", False, 2), ("rgb", False, 0)],
)
def test_a_lost_slice_leaves_the_others(color: str, lapped: bool, beyond: int) -> None:
    image = photograph(112, 64, 3)
    ours = codec(restart=2, color=color, lapped=lapped, qf=1)
    stream = bytearray(ours.encode(image))
    whole = ours.decode(bytes(stream))
    assert salvage(bytes(stream)).lost == []
    assert np.array_equal(salvage(bytes(stream)).image, whole)
    sizes = struct.unpack_from("<4I", stream, 55)
    start = 55 + 20 + sizes[0] + 4
    stream[start : start + sizes[1]] = bytes(sizes[1])
    result = salvage(bytes(stream))
    assert result.lost == [range(32, 64)]
    assert np.array_equal(result.image[: 32 - beyond], whole[: 32 - beyond])
    assert np.array_equal(result.image[64 + beyond :], whole[64 + beyond :])
    assert not np.array_equal(result.image[40:56], whole[40:56])


@pytest.mark.thorough
@pytest.mark.parametrize(("lapped", "transform"), [(True, "lapped_transform"), (False, "dct")])
def test_counting_changes_nothing_and_names_the_stages(lapped: bool, transform: str) -> None:
    image, ours = photograph(32, 40, 3), codec(qf=2, restart=1, lapped=lapped)
    encoding, decoding = CountingTrace(), CountingTrace()
    stream = ours.encode(image, trace=encoding)
    assert stream == ours.encode(image)
    assert np.array_equal(ours.decode(stream, trace=decoding), ours.decode(stream))
    assert list(encoding.counts) == [
        "color_transform", transform, "quantization", "optimization", "centroids", "padding", "context_coding",
    ]  # fmt: skip
    assert list(decoding.counts) == [
        "context_decoding", "dequantization", "inverse_lapped_transform" if lapped else "idct", "cropping",
        "inverse_color_transform",
    ]  # fmt: skip
    assert all(counts.total > 0 for counts in (*encoding.counts.values(), *decoding.counts.values()))


def test_defaults_are_those_of_the_profile() -> None:
    ours = MultilevelParams(profile="context")
    assert (ours.table, ours.color) == ("flat", "ycbcr420")
    assert MultilevelParams().table == "paper"
    assert MultilevelParams(profile="context", table="standard").table == "standard"


@pytest.mark.parametrize(
    ("params", "name"),
    [
        ({"profile": "context", "levels": 2}, "levels"),
        ({"profile": "context", "scan": "coefficient"}, "scan"),
        ({"profile": "context", "decoding": "search"}, "decoding"),
        ({"lapped": True}, "lapped"),
        ({"threads": 2}, "threads"),
        ({"restart": 4}, "restart"),
    ],
)
def test_parameters_of_the_other_profile_are_refused(params: dict[str, Any], name: str) -> None:
    with pytest.raises(ValidationError, match=f"{name}: the profile"):
        MultilevelParams(**params)


def test_threads_share_slices_and_change_nothing() -> None:
    image = textured(120, 72, 3)
    for setting in ({"qf": 1}, {"qf": 0.5, "effort": "fast", "lapped": True}):
        one, three = (codec(restart=2, threads=threads, **setting) for threads in (1, 3))
        stream = one.encode(image)
        assert three.encode(image) == stream
        assert np.array_equal(three.decode(stream), one.decode(stream))


@pytest.mark.thorough
def test_slices_on_threads_are_counted() -> None:
    image, threads = textured(120, 72, 3), codec(restart=2, threads=3)
    trace = CountingTrace()
    assert threads.encode(image, trace=trace) == threads.encode(image)
    assert trace.counts["context_coding"].total > 0


def test_damage_is_refused_by_threads_too() -> None:
    threads = codec(restart=1, threads=2)
    stream = bytearray(threads.encode(textured(64, 40)))
    stream[-30] ^= 1
    with pytest.raises(BitstreamError, match="CRC-32"):
        threads.decode(bytes(stream))


def test_threads_need_slices() -> None:
    with pytest.raises(ValidationError, match="set restart too"):
        codec(threads=2)


def test_a_noisy_picture_at_the_finest_step_fits() -> None:
    """More than a byte a sample: the buffer grows."""
    image = np.random.default_rng(0).integers(0, 256, (64, 64)).astype(np.uint8)
    stream = codec(qf=0.001).encode(image)
    assert len(stream) > image.size
    assert np.array_equal(codec().decode(stream), image)
