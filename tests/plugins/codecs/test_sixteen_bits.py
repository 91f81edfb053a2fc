"""Frames of 16 bits: every lossless setting returns every bit, and other programs read the same files."""

from __future__ import annotations

import io
import zlib
from typing import Any

import numpy as np
import PIL.Image
import pytest
import skimage.io
from depth_frames import DEPTH, HOLES, IMAGES, real_frames

from codecbench import BitstreamError, Codec, Image, ImageError, Unsupported
from codecbench.core.engine.plugins.registry import installed
from codecbench.plugins.codecs import enveloped

NAMES = ("raw", "png", "jpeg2000", "htj2k", "jpegxl", "jpegls", "zstd", "lz4", "lerc", "zfp", "rvl")
ENVELOPED = ("htj2k", "jpegxl", "jpegls", "zstd", "lz4", "lerc", "zfp")
LOSSLESS = {"jpeg2000": {"lossless": True}, "htj2k": {"step": 0}, "jpegxl": {"distance": 0}}
SETTINGS = [(name, LOSSLESS.get(name, {})) for name in NAMES]
SETTINGS += [
    ("png", {"effort": 9}),
    ("jpeg2000", {"lossless": True, "layers": 3}),
    ("jpegxl", {"distance": 0, "effort": 1}),
]
SETTINGS += [("zstd", {"level": 19}), ("lz4", {"level": 12})]
EVERY_SETTING = pytest.mark.parametrize(("name", "setting"), SETTINGS)
_HEADER_BYTES = 18


def codec_of(name: str, setting: dict[str, Any] | None = None) -> Codec[Any]:
    plugin = installed().find("codec", name)
    if plugin.missing is not None:
        pytest.skip(plugin.missing)
    codec: Codec[Any] = installed().create("codec", name, LOSSLESS.get(name, {}) if setting is None else setting)
    return codec


def test_all_that_take_16_bits_are_here() -> None:
    shipped = [plugin for plugin in installed().plugins("codec") if not plugin.hosted and plugin.missing is None]
    classes = [installed().load("codec", plugin.spec.name) for plugin in shipped]
    stateless = {cls.name for cls in classes if cls.stateless and 16 in cls.capabilities.bits}
    assert stateless == set(NAMES) & {cls.name for cls in classes}


def require_every_bit(codec: Codec[Any], image: Image) -> None:
    decoded = codec.decode(codec.encode(image))
    assert codec.is_lossless()
    assert decoded.dtype == np.uint16
    np.testing.assert_array_equal(decoded, image)


@EVERY_SETTING
@pytest.mark.parametrize("content", IMAGES)
def test_every_bit_returns(name: str, setting: dict[str, Any], content: str) -> None:
    require_every_bit(codec_of(name, setting), IMAGES[content])


@EVERY_SETTING
def test_every_bit_of_real_depth_returns(name: str, setting: dict[str, Any]) -> None:
    codec = codec_of(name, setting)
    for frame in real_frames():
        require_every_bit(codec, frame)


@pytest.mark.parametrize(
    ("name", "setting", "max_error"),
    [
        ("jpegls", {"near": 3}, 3),
        ("jpegls", {"near": 255}, 255),
        ("lerc", {"max_error": 1}, 1),
        ("lerc", {"max_error": 100}, 100),
        ("zfp", {"max_error": 1}, 1),
        ("zfp", {"max_error": 100}, 100),
    ],
)
@pytest.mark.parametrize("content", IMAGES)
def test_no_pixel_errs_by_more_than_was_asked_for(
    name: str, setting: dict[str, Any], max_error: int, content: str
) -> None:
    codec = codec_of(name, setting)
    assert not codec.is_lossless()
    decoded = codec.decode(codec.encode(IMAGES[content]))
    assert decoded.dtype == np.uint16
    assert np.abs(decoded.astype(int) - IMAGES[content]).max() <= max_error


@pytest.mark.parametrize(
    ("name", "better", "worse"),
    [
        ("jpeg2000", {"ratio": 4}, {"ratio": 30}),
        ("jpeg2000", {"psnr_db": 90}, {"psnr_db": 60}),
        ("htj2k", {"step": 1e-5}, {"step": 1e-3}),
        ("jpegxl", {"distance": 0.01}, {"distance": 1}),
        ("jpegls", {"near": 1}, {"near": 100}),
        ("lerc", {"max_error": 1}, {"max_error": 100}),
        ("zfp", {"max_error": 2}, {"max_error": 200}),
    ],
)
def test_lossy_settings_trade_size_for_errors(name: str, better: dict[str, Any], worse: dict[str, Any]) -> None:
    sizes, errors = [], []
    for setting in (better, worse):
        codec = codec_of(name, setting)
        bitstream = codec.encode(DEPTH)
        sizes.append(len(bitstream))
        errors.append(np.sqrt(np.mean((codec.decode(bitstream).astype(float) - DEPTH) ** 2)))
    assert sizes[0] > sizes[1]
    assert errors[0] < errors[1] < 700


def test_a_target_psnr_is_of_16_bits() -> None:
    codec = codec_of("jpeg2000", {"psnr_db": 80})
    image = np.tile(DEPTH, (4, 4))
    error = codec.decode(codec.encode(image)).astype(float) - image
    assert 20 * np.log10(65535 / np.sqrt(np.mean(error**2))) == pytest.approx(80, abs=3)


def test_cr_percent_is_relative_to_the_png_of_16_bits() -> None:
    image = np.tile(HOLES, (2, 2))
    size = len(codec_of("jpeg2000", {"cr_percent": 60}).encode(image))
    assert 0.97 < size / (0.4 * len(codec_of("png").encode(image))) <= 1


@pytest.mark.parametrize("content", IMAGES)
def test_others_read_the_png(content: str) -> None:
    bitstream = codec_of("png").encode(IMAGES[content])
    assert bitstream[24:26] == bytes((16, 0)), "depth and color type of IHDR"
    np.testing.assert_array_equal(np.asarray(PIL.Image.open(io.BytesIO(bitstream))), IMAGES[content])
    np.testing.assert_array_equal(skimage.io.imread(io.BytesIO(bitstream)), IMAGES[content])


@pytest.mark.parametrize("setting", [{"lossless": True}, {"ratio": 6}], ids=str)
def test_others_read_the_jp2(setting: dict[str, Any]) -> None:
    codec = codec_of("jpeg2000", setting)
    bitstream = codec.encode(DEPTH)
    assert bitstream[bitstream.index(b"ihdr") + 14] == 15
    theirs = np.asarray(PIL.Image.open(io.BytesIO(bitstream)))
    np.testing.assert_array_equal(theirs, codec.decode(bitstream))


READERS: dict[str, Any] = {
    "htj2k": lambda library, content: library.jpeg2k_decode(content),
    "jpegxl": lambda library, content: library.jpegxl_decode(content),
    "jpegls": lambda library, content: library.jpegls_decode(content),
    "lerc": lambda library, content: library.lerc_decode(content),
    "zfp": lambda library, content: library.zfp_decode(content).astype(np.uint16),
    "zstd": lambda library, content: np.frombuffer(library.zstd_decode(content), "<u2").reshape(HOLES.shape),
    "lz4": lambda library, content: np.frombuffer(library.lz4f_decode(content), "<u2").reshape(HOLES.shape),
}


@pytest.mark.parametrize("name", ENVELOPED)
def test_the_library_itself_reads_what_is_in_the_envelope(name: str) -> None:
    library = pytest.importorskip("imagecodecs", reason="the extra `codecs` is not installed")
    bitstream = codec_of(name).encode(HOLES)
    assert bitstream[4:6] == bytes((1, 16)), "channels and bits"
    read = READERS[name](library, bitstream[_HEADER_BYTES:])
    assert read.dtype == np.uint16
    np.testing.assert_array_equal(read, HOLES)


@pytest.mark.parametrize("name", ENVELOPED)
@pytest.mark.parametrize("shape", [(60, 82), (83, 61), (900, 900)])
def test_a_header_of_another_size_is_refused(name: str, shape: tuple[int, int]) -> None:
    codec = codec_of(name)
    with pytest.raises(BitstreamError):
        codec.decode(_in_envelope(codec, codec.encode(DEPTH)[_HEADER_BYTES:], shape))


def _in_envelope(codec: Any, content: bytes, shape: tuple[int, int]) -> bytes:
    header = enveloped._HEADER.pack(codec.magic, 1, 16, shape[1], shape[0])
    return header + zlib.crc32(content, zlib.crc32(header)).to_bytes(4, "little") + content


def test_zfp_reads_no_memory_behind_its_bitstream(rng: np.random.Generator) -> None:
    """A cut file with a right checksum: what follows is read as zeros, so all decode alike."""
    codec = codec_of("zfp")
    shape = (1200, 1600)
    content = codec.encode(rng.integers(0, 65536, shape, dtype=np.uint16))[_HEADER_BYTES:]
    decoded = [codec.decode(_in_envelope(codec, content[:length], shape)) for length in (40, 40, 5000, 5000)]
    np.testing.assert_array_equal(decoded[0], decoded[1])
    np.testing.assert_array_equal(decoded[2], decoded[3])
    assert not decoded[2][-4:].any()
    expert = content[:10] + b"\xff" * 9 + content[19:]
    with pytest.raises(BitstreamError, match="mode"):
        codec.decode(_in_envelope(codec, expert, shape))


@pytest.mark.parametrize("name", NAMES)
def test_layouts_that_a_codec_does_not_take_are_refused(name: str) -> None:
    codec = codec_of(name)
    with pytest.raises(ImageError):
        codec.encode(np.zeros((4, 4, 3), np.uint16))
    if codec.capabilities.bits == (16,):
        with pytest.raises(ImageError):
            codec.encode(np.zeros((4, 4), np.uint8))


def test_near_is_limited_by_the_bits_of_the_samples() -> None:
    with pytest.raises(Unsupported, match="near 128 exceeds 127"):
        codec_of("jpegls", {"near": 128}).encode(np.zeros((4, 4), np.uint8))


def test_raw_has_a_magic_of_its_own_and_little_endian_samples() -> None:
    bitstream = codec_of("raw").encode(np.array([[0x0102, 0xFFFE]], np.uint16))
    assert bitstream[:17] == b"RAW2\x01" + b"\x02\0\0\0\x01\0\0\0" + b"\x02\x01\xfe\xff"
