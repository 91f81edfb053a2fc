"""Our JPEG files in the hands of other decoders, other encoders' files in ours, and damage to both."""

from __future__ import annotations

import hashlib
import io
import json
import os
import shutil
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import PIL.Image
import pytest
import skimage.data
from damage import outcomes
from project import GOLDEN
from skimage.metrics import peak_signal_noise_ratio

from codecbench import BitstreamError, ImageError, gray_from_image
from codecbench.core.counting.trace import CountingTrace
from codecbench.plugins.codecs.dct.tables import LUMINANCE, PAPER, ZIGZAG
from codecbench.plugins.codecs.jpeg_qf import JpegQf

PICTURE = np.ascontiguousarray(skimage.data.astronaut()[60:203, 100:277])
GRAY = np.ascontiguousarray(PICTURE[..., 1])
SETTINGS: list[dict[str, Any]] = [
    {"qf": 5},
    {"qf": 100, "optimize": True},
    {"qf": 0.2, "table": "standard"},
    {"qf": 2.5, "table": "standard", "color": "ycbcr420", "optimize": True},
    {"qf": 20, "color": "ycbcr420"},
    {"qf": 1000},
]
EVERY_SETTING = pytest.mark.parametrize("setting", SETTINGS, ids=str)
IMAGES = pytest.mark.parametrize("image", [PICTURE, GRAY], ids=["rgb", "gray"])
STREAMS = GOLDEN / "jpeg_qf"


def _tool(name: str) -> str:
    path = shutil.which(name)
    if path is None:
        pytest.skip(f"{name} is not installed; it comes with libjpeg-turbo-progs")
    return path


def _run(tool: str, *options: str, data: bytes) -> bytes:
    return subprocess.run([_tool(tool), *options], input=data, capture_output=True, check=True).stdout


def _pnm(image: np.ndarray) -> bytes:
    kind = 5 if image.ndim == 2 else 6
    return f"P{kind}\n{image.shape[1]} {image.shape[0]}\n255\n".encode() + image.tobytes()


def _read(reader: str, bitstream: bytes) -> np.ndarray:
    if reader == "pillow":
        return np.asarray(PIL.Image.open(io.BytesIO(bitstream)))
    if reader == "djpeg":
        bitstream = _run("djpeg", "-pnm", data=bitstream)
    image = cv2.imdecode(np.frombuffer(bitstream, np.uint8), cv2.IMREAD_UNCHANGED)
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def _require_close(got: np.ndarray, expected: np.ndarray) -> None:
    """Within 1 gray level. Color adds up to 1.772 for every level of chroma, so single channels get 3."""
    assert got.shape == expected.shape
    assert np.abs(gray_from_image(got).astype(int) - gray_from_image(expected)).max() <= 1
    assert np.abs(got.astype(int) - expected).max() <= (1 if got.ndim == 2 else 3)


@pytest.mark.thorough
@pytest.mark.parametrize("reader", ["opencv", "pillow", "djpeg"])
@EVERY_SETTING
@IMAGES
def test_other_decoders_read_the_same_picture(image: np.ndarray, setting: dict[str, Any], reader: str) -> None:
    codec = JpegQf.create(**setting)
    bitstream = codec.encode(image)
    _require_close(codec.decode(bitstream), _read(reader, bitstream))


@pytest.mark.thorough
@pytest.mark.parametrize("width", [1, 2, 3, 4, 5, 6, 8, 15, 16, 17])
def test_other_decoders_agree_on_small_color_images(width: int, rng: np.random.Generator) -> None:
    image = rng.integers(0, 256, (width + 2, width, 3), dtype=np.uint8)
    codec = JpegQf.create(qf=1, color="ycbcr420")
    bitstream = codec.encode(image)
    _require_close(codec.decode(bitstream), _read("opencv", bitstream))


@pytest.mark.thorough
@pytest.mark.parametrize(
    "options",
    [
        ["-quality", "80", "-sample", "1x1"],
        ["-quality", "80", "-sample", "2x1"],
        ["-quality", "80", "-sample", "2x2", "-optimize"],
        ["-quality", "30", "-sample", "2x2", "-restart", "1"],
        ["-quality", "95", "-sample", "1x1", "-restart", "7B"],
        ["-quality", "5"],
        ["-quality", "100", "-sample", "1x1"],
        ["-grayscale", "-restart", "3B"],
        ["-grayscale", "-quality", "100"],
    ],
    ids=" ".join,
)
def test_other_encoders_files_are_read(options: list[str]) -> None:
    bitstream = _run("cjpeg", *options, data=_pnm(PICTURE))
    _require_close(JpegQf.create().decode(bitstream), _read("opencv", bitstream))


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (["-progressive"], "FFC2"),
        (["-arithmetic"], "FFC9"),
        (["-rgb"], "color transform|RGB"),
        (["-sample", "1x2"], "sampling factors"),
        (["-sample", "4x1"], "sampling factors"),
    ],
)
def test_other_kinds_of_jpeg_are_refused_by_name(options: list[str], reason: str) -> None:
    bitstream = _run("cjpeg", *options, data=_pnm(PICTURE))
    with pytest.raises(BitstreamError, match=reason):
        JpegQf.create().decode(bitstream)


@pytest.mark.thorough
def test_several_scans_are_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "scans").write_text("0;\n1;\n2;\n")
    bitstream = _run("cjpeg", "-scans", str(tmp_path / "scans"), data=_pnm(PICTURE))
    with pytest.raises(BitstreamError, match="3 scans"):
        JpegQf.create().decode(bitstream)


@pytest.mark.thorough
@IMAGES
@pytest.mark.parametrize("color", ["ycbcr444", "ycbcr420"])
def test_optimised_tables_are_those_of_libjpeg(image: np.ndarray, color: str) -> None:
    image = np.ascontiguousarray(image[:128, :160])  # whole MCUs: jpegtran empties blocks beyond the image
    plain = JpegQf.create(qf=3, color=color).encode(image)
    ours = JpegQf.create(qf=3, color=color, optimize=True).encode(image)
    theirs = _run("jpegtran", "-optimize", "-copy", "none", data=plain)
    assert _huffman_tables(ours) == _huffman_tables(theirs)
    assert ours[ours.index(b"\xff\xda") :] == theirs[theirs.index(b"\xff\xda") :]


@pytest.mark.thorough
@IMAGES
def test_example_tables_are_those_of_libjpeg(image: np.ndarray) -> None:
    theirs = _run("cjpeg", "-baseline", "-sample", "1x1", data=_pnm(image))
    assert _huffman_tables(JpegQf.create().encode(image)) == _huffman_tables(theirs)


def _huffman_tables(bitstream: bytes) -> dict[int, bytes]:
    tables, position = {}, 2
    while bitstream[position + 1] != 0xDA:
        (length,) = struct.unpack_from(">H", bitstream, position + 2)
        content = bitstream[position + 4 : position + 2 + length]
        while bitstream[position + 1] == 0xC4 and content:
            size = 17 + sum(content[1:17])
            tables[content[0]] = content[1:size]
            content = content[size:]
        position += 2 + length
    return tables


@pytest.mark.parametrize(("table", "values"), [("paper", PAPER), ("standard", LUMINANCE)])
@pytest.mark.parametrize(("qf", "marker", "precision"), [(2, 0xC0, 0), (100, 0xC1, 1)])
def test_steps_are_the_table_times_qf(table: str, values: np.ndarray, qf: float, marker: int, precision: int) -> None:
    bitstream = JpegQf.create(qf=qf, table=table).encode(GRAY)
    start = bitstream.index(b"\xff\xdb") + 5
    steps = np.frombuffer(bitstream[start : start + 64 * (1 + precision)], ">u2" if precision else "u1")
    assert bitstream[start - 1] == precision << 4
    assert bytes((0xFF, marker)) in bitstream
    assert list(steps) == list(values.reshape(64)[ZIGZAG] * qf)


def test_psnr_falls_and_size_falls_with_qf() -> None:
    codecs = [JpegQf.create(qf=qf) for qf in (1, 5, 10, 20, 50, 100)]
    bitstreams = [codec.encode(GRAY) for codec in codecs]
    sizes = [len(bitstream) for bitstream in bitstreams]
    psnr = [peak_signal_noise_ratio(GRAY, codecs[0].decode(bitstream)) for bitstream in bitstreams]
    assert sizes == sorted(sizes, reverse=True)
    assert psnr == sorted(psnr, reverse=True)


def test_color_gray_is_the_gray_picture() -> None:
    codec = JpegQf.create(qf=5, color="gray")
    assert codec.encode(PICTURE) == codec.encode(gray_from_image(PICTURE))


@pytest.mark.thorough
def test_operations_are_counted_by_the_stages_of_t81() -> None:
    codec = JpegQf.create(qf=5, color="ycbcr420", optimize=True)
    encoding, decoding = CountingTrace(), CountingTrace()
    bitstream = codec.encode(PICTURE[:40, :40], trace=encoding)
    codec.decode(bitstream, trace=decoding)
    assert list(encoding.counts) == ["color_transform", "padding", "dct", "quantization", "zigzag", "huffman"]
    assert list(decoding.counts)[:4] == ["huffman", "zigzag", "dequantization", "idct"]
    assert {"cropping", "inverse_color_transform"} == set(list(decoding.counts)[4:])


def test_no_damage_to_our_files_goes_unnoticed() -> None:
    images = [PICTURE[:80, :80], GRAY[:80, :80], PICTURE[:9, :13], GRAY[:1, :1]]
    bitstreams = [JpegQf.create(**setting).encode(image) for image in images for setting in SETTINGS[:5]]
    found = outcomes(JpegQf.create(), bitstreams, 10_000, seed=5)
    assert found["changed"] == 0
    assert found["refused"] > 9_900


@pytest.mark.thorough
def test_damage_to_files_without_a_checksum_neither_crashes_nor_hangs() -> None:
    options = (["-sample", "2x2"], ["-sample", "1x1", "-restart", "2B"], ["-grayscale", "-optimize"])
    bitstreams = [_run("cjpeg", *option, data=_pnm(PICTURE[:40, :40])) for option in options]
    found = outcomes(JpegQf.create(), bitstreams, 3_000, seed=6)
    assert found["refused"] > 1_000


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("size", "reason"),
    [((65535, 65535), "65535x65535 .*pixels"), ((8192, 8192), "8192x8192 .*pixels"), ((0, 9), "9x0 .*pixels"),
     ((9, 0), "0x9 .*pixels")],
)  # fmt: skip
def test_a_header_that_claims_too_much_is_refused(size: tuple[int, int], reason: str) -> None:
    bitstream = bytearray(_run("cjpeg", "-grayscale", data=_pnm(GRAY)))
    place = bytes(bitstream).index(b"\xff\xc0") + 5
    bitstream[place : place + 4] = struct.pack(">HH", *size)
    with pytest.raises(BitstreamError, match=reason):
        JpegQf.create().decode(bytes(bitstream))


def _golden_picture(channels: int) -> np.ndarray:
    """A picture made with integers only, so that it is the same everywhere."""
    rows, columns = np.mgrid[0:45, 0:67]
    plane = (rows * 3 + columns * 2 + (rows * columns) // 17 + 60 * ((rows // 9 + columns // 11) % 2)) % 256
    planes = [plane, (plane + columns) % 256, 255 - plane]
    return np.ascontiguousarray(np.stack(planes[:channels], axis=2).squeeze().astype(np.uint8))


@EVERY_SETTING
@pytest.mark.parametrize("channels", [1, 3])
def test_bitstreams_and_pixels_are_the_golden_ones(channels: int, setting: dict[str, Any]) -> None:
    name = "-".join(["gray" if channels == 1 else "rgb", *(f"{key}={value}" for key, value in setting.items())])
    file, manifest = STREAMS / f"{name}.jpg", STREAMS / "pixels.json"
    bitstream = JpegQf.create(**setting).encode(_golden_picture(channels))
    if os.environ.get("CODECBENCH_REGENERATE_GOLDEN"):
        digests = json.loads(manifest.read_text()) if manifest.exists() else {}
        digests[name] = hashlib.sha256(JpegQf.create().decode(bitstream).tobytes()).hexdigest()
        file.write_bytes(bitstream)
        manifest.write_text(json.dumps(digests, indent=1, sort_keys=True) + "\n")
    assert bitstream == file.read_bytes()
    digest = hashlib.sha256(JpegQf.create().decode(file.read_bytes()).tobytes()).hexdigest()
    assert digest == json.loads(manifest.read_text())[name]


_DECODE_AND_TELL_MEMORY = """
import resource, sys
from codecbench.plugins.codecs.jpeg_qf import JpegQf
codec, bitstream = JpegQf.create(), sys.stdin.buffer.read()
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
assert codec.decode(bitstream).shape == (4096, 4096, 3)
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) // 1024)
"""


@pytest.mark.thorough
def test_the_largest_picture_in_the_fewest_bytes_decodes_within_512_megabytes() -> None:
    bitstream = JpegQf.create(qf=20, optimize=True).encode(np.full((4096, 4096, 3), 77, np.uint8))
    assert len(bitstream) < 200_000
    done = subprocess.run(
        [sys.executable, "-c", _DECODE_AND_TELL_MEMORY], input=bitstream, capture_output=True, check=True
    )
    assert int(done.stdout) < 512


def test_larger_pictures_are_refused() -> None:
    with pytest.raises(ImageError, match="16777216 pixels"):
        JpegQf.create().encode(np.zeros((4096, 4097), np.uint8))
