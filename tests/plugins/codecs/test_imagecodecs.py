"""The codecs of imagecodecs: what their settings promise, and that the envelope notices damage."""

from __future__ import annotations

import importlib.metadata
import io
import re
import zlib
from typing import Any

import numpy as np
import PIL.Image
import pytest
import skimage.data
from damage import outcomes
from skimage.metrics import peak_signal_noise_ratio

pytest.importorskip("imagecodecs", reason="the extra `codecs` is not installed")

from codecbench import BitstreamError
from codecbench.plugins.codecs import enveloped
from codecbench.plugins.codecs.arrays import Lerc, Lz4, Zfp, Zstd
from codecbench.plugins.codecs.imagecodecs import Avif, Htj2k, JpegLs, JpegXl, Webp

PICTURE = np.ascontiguousarray(skimage.data.astronaut()[60:188, 100:261])
GRAY = np.ascontiguousarray(PICTURE[..., 1])
CODECS: list[Any] = [JpegXl, JpegLs, Htj2k, Webp, Avif, Zstd, Lz4, Lerc, Zfp]
LIBRARIES = {"jpegxl": ("libjxl",), "jpegls": ("charls",), "htj2k": ("openjph", "openjpeg")}
LIBRARIES |= {"webp": ("libwebp",), "avif": ("libavif",)}
EVERY_CODEC = pytest.mark.parametrize("codec_class", CODECS, ids=lambda codec_class: codec_class.name)
IMAGES = pytest.mark.parametrize("image", [PICTURE, GRAY], ids=["rgb", "gray"])
_ENVELOPE_BYTES = 18


def pictures_for(codec_class: Any) -> list[np.ndarray]:
    """A gray picture, and one in color unless the codec takes 16 bits only."""
    return [GRAY * np.uint16(257)] if codec_class.capabilities.bits == (16,) else [GRAY, PICTURE]


@IMAGES
@pytest.mark.parametrize(
    ("codec_class", "better", "worse"),
    [
        (JpegXl, {"distance": 0.5}, {"distance": 3}),
        (JpegLs, {"near": 1}, {"near": 5}),
        (Htj2k, {"step": 0.005}, {"step": 0.05}),
        (Webp, {"quality": 90}, {"quality": 20}),
        (Avif, {"quality": 85}, {"quality": 30}),
    ],
)
def test_settings_trade_size_for_quality(
    codec_class: Any, better: dict[str, Any], worse: dict[str, Any], image: np.ndarray
) -> None:
    sizes, psnr = [], []
    for setting in (better, worse):
        codec = codec_class.create(**setting)
        bitstream = codec.encode(image)
        sizes.append(len(bitstream))
        psnr.append(peak_signal_noise_ratio(image, codec.decode(bitstream)))
    assert sizes[0] > sizes[1]
    assert psnr[0] > psnr[1] > 22


@IMAGES
@pytest.mark.parametrize("step", [0.01, 0.06, 0.2])
def test_htj2k_stops_at_black_and_white(image: np.ndarray, step: float) -> None:
    """Overexposed and underexposed, the picture is as good as it is without: nothing wraps round."""
    codec = Htj2k.create(step=step)
    usual = peak_signal_noise_ratio(image, codec.decode(codec.encode(image)))
    for exposed in (np.clip(image.astype(int) + 120, 0, 255), np.clip(image.astype(int) - 120, 0, 255)):
        picture = exposed.astype(np.uint8)
        assert peak_signal_noise_ratio(picture, codec.decode(codec.encode(picture))) > usual - 0.5


@IMAGES
def test_near_lossless_keeps_its_bound(image: np.ndarray) -> None:
    codec = JpegLs.create(near=4)
    assert np.abs(codec.decode(codec.encode(image)).astype(int) - image).max() == 4


@pytest.mark.parametrize("codec_class", [Webp, Avif], ids=lambda codec_class: codec_class.name)
def test_what_the_envelope_holds_is_a_file_of_the_standard(codec_class: Any) -> None:
    codec = codec_class.create()
    bitstream = codec.encode(PICTURE)
    theirs = np.asarray(PIL.Image.open(io.BytesIO(bitstream[_ENVELOPE_BYTES:])).convert("RGB"))
    assert np.abs(theirs.astype(int) - codec.decode(bitstream)).max() <= 3


@pytest.mark.parametrize("codec_class", [Htj2k, Avif], ids=lambda codec_class: codec_class.name)
@pytest.mark.parametrize("shape", [(64, 48, 3), (48, 64, 3)])
def test_a_file_that_declares_another_size_is_not_decoded(
    codec_class: Any, shape: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Their libraries allocate for what the file declares, and compare it afterwards."""
    codec = codec_class.create()
    content = codec.encode(np.full((1200, 900, 3), 120, np.uint8))[_ENVELOPE_BYTES:]
    header = enveloped._HEADER.pack(codec.magic, 3, 0, shape[1], shape[0])
    monkeypatch.setattr(codec, "_library", None)
    with pytest.raises(BitstreamError, match="declare"):
        codec.decode(header + zlib.crc32(content, zlib.crc32(header)).to_bytes(4, "little") + content)


@EVERY_CODEC
def test_no_damage_goes_unnoticed(codec_class: Any) -> None:
    codec = codec_class.create()
    found = outcomes(codec, [codec.encode(image[:20, :30]) for image in pictures_for(codec_class)], 1_000, seed=2)
    assert found["changed"] == 0


@EVERY_CODEC
def test_bitstreams_of_the_others_are_refused(codec_class: Any) -> None:
    for other in CODECS:
        if other is not codec_class:
            with pytest.raises(BitstreamError, match=f"^{codec_class.name}: .*{re.escape(repr(other.magic))}"):
                codec_class.create().decode(other.create().encode(pictures_for(other)[0]))


@EVERY_CODEC
def test_the_library_that_codes_is_recorded_with_its_version(codec_class: Any) -> None:
    libraries = codec_class.create().libraries()
    assert libraries.pop("imagecodecs") == importlib.metadata.version("imagecodecs")
    assert set(libraries) == set(LIBRARIES.get(codec_class.name, (codec_class.name,)))
    assert all(re.match(r"\d+\.\d+\.\d+", version) for version in libraries.values())


@pytest.mark.parametrize(("codec_class", "library"), [(JpegXl, "libjxl 0.11.2"), (Avif, "libavif 1.4.0")])
def test_another_library_whose_pixels_differ_is_another_version(codec_class: Any, library: str) -> None:
    name, version = library.split()
    installed = codec_class.create().libraries()[name]
    assert codec_class.version == ("1" if installed == version else f"1+{name}-{installed}")


@pytest.mark.parametrize("subsampling", ["444", "422", "420"])
def test_avif_samples_chroma_as_it_was_told(subsampling: str) -> None:
    """By the two bits in which the property `av1C` (AV1 in ISOBMFF, 2.3.3) says how chroma is sampled."""
    content = Avif.create(subsampling=subsampling).encode(PICTURE)
    flags = content[content.index(b"av1C") + 4 + 2]
    assert (flags >> 3 & 1, flags >> 2 & 1) == {"444": (0, 0), "422": (1, 0), "420": (1, 1)}[subsampling]
