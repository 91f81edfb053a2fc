"""JPEG 2000 against OpenJPEG's own tools, its rates, and the search for the library."""

from __future__ import annotations

import importlib.metadata
import os
import shutil
import subprocess
import sys
import tempfile
import zlib
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import skimage.data
from pydantic import ValidationError
from skimage.metrics import peak_signal_noise_ratio

from codecbench import BitstreamError, ImageError, Unsupported
from codecbench.core.contracts.codec import Fragment
from codecbench.core.contracts.image import png_bytes
from codecbench.plugins.codecs import jp2_syntax, jpeg2000
from codecbench.plugins.codecs.jpeg2000 import Jpeg2000

PICTURE = np.ascontiguousarray(skimage.data.astronaut()[:240, :320])
GRAY = np.ascontiguousarray(PICTURE[..., 1])
IMAGES = pytest.mark.parametrize("image", [PICTURE, GRAY], ids=["rgb", "gray"])


def _tool(name: str) -> str:
    path = shutil.which(name)
    if path is None:
        pytest.skip(f"{name} is not installed; it comes with libopenjp2-tools")
    return path


def _opj_decompress(bitstream: bytes, folder: Path, *more: str) -> np.ndarray:
    (folder / "in.jp2").write_bytes(bitstream)
    command = [_tool("opj_decompress"), "-i", str(folder / "in.jp2"), "-o", str(folder / "out.png"), "-quiet", *more]
    subprocess.run(command, check=True, capture_output=True)
    image = cv2.imread(str(folder / "out.png"), cv2.IMREAD_UNCHANGED)
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


@pytest.mark.thorough
@IMAGES
@pytest.mark.parametrize(
    "values",
    [
        {"ratio": 20},
        {"lossless": True},
        {"psnr_db": 35},
        {"ratio": 10, "irreversible": False},
        {"ratio": 10, "layers": 5},
        {"lossless": True, "layers": 3},
    ],
)
def test_opj_decompress_reads_the_same_pixels(image: np.ndarray, values: dict[str, Any], tmp_path: Path) -> None:
    codec = Jpeg2000.create(**values)
    bitstream = codec.encode(image)
    np.testing.assert_array_equal(_opj_decompress(bitstream, tmp_path), codec.decode(bitstream))


@pytest.mark.thorough
@IMAGES
@pytest.mark.parametrize("ratio", [8, 25, 60])
def test_opj_compress_makes_files_of_the_same_size_and_quality(image: np.ndarray, ratio: int, tmp_path: Path) -> None:
    (tmp_path / "in.png").write_bytes(png_bytes(image))
    command = [_tool("opj_compress"), "-i", str(tmp_path / "in.png"), "-o", str(tmp_path / "out.jp2")]
    subprocess.run([*command, "-r", str(ratio), "-I"], check=True, capture_output=True)
    codec = Jpeg2000.create(ratio=ratio)
    ours, theirs = codec.encode(image), (tmp_path / "out.jp2").read_bytes()
    assert len(ours) == pytest.approx(len(theirs), rel=0.02)
    psnr = [peak_signal_noise_ratio(image, _opj_decompress(stream, tmp_path)) for stream in (ours, theirs)]
    assert psnr[0] == pytest.approx(psnr[1], abs=1)


@IMAGES
@pytest.mark.parametrize("cr_percent", [60, 73, 82, 85, 91, 97])
def test_cr_percent_is_reached_and_not_exceeded(image: np.ndarray, cr_percent: float) -> None:
    target = len(png_bytes(image)) * (1 - cr_percent / 100)
    size = len(Jpeg2000.create(cr_percent=cr_percent).encode(image))
    assert 0.98 * target <= size + 1
    assert size <= target


class CountsFiles(Jpeg2000):
    """Keeps count of the files that OpenJPEG writes, over all instances."""

    written = 0

    def _write(self, image: np.ndarray, *args: Any, **rate: Any) -> bytes:
        CountsFiles.written += 1
        return super()._write(image, *args, **rate)


def test_cr_percent_searches_once_and_a_prepared_instance_writes_one_file(monkeypatch: pytest.MonkeyPatch) -> None:
    codec = CountsFiles.create(cr_percent=91)
    bitstream = codec.encode(GRAY)
    searched = CountsFiles.written
    assert searched > 1, "a picture whose search takes several trials is needed here"
    prepared = codec.prepared(GRAY)
    assert CountsFiles.written == 2 * searched
    monkeypatch.setattr(jpeg2000, "png_bytes", None)  # no PNG is asked for any more
    assert prepared.encode(GRAY) == bitstream
    assert CountsFiles.written == 2 * searched + 1


@pytest.mark.parametrize("values", [{"ratio": 20}, {"psnr_db": 35}, {"lossless": True}])
def test_other_rates_need_no_search(values: dict[str, Any]) -> None:
    codec = Jpeg2000.create(**values)
    assert codec.prepared(PICTURE) is codec


def test_preparing_refuses_what_encoding_refuses() -> None:
    codec = Jpeg2000.create(cr_percent=90)
    with pytest.raises(Unsupported, match="this frame needs"):
        codec.prepared(GRAY[:9, :9])
    with pytest.raises(ImageError):
        codec.prepared(GRAY.astype(np.float32))


def test_cr_percent_that_no_file_can_reach_is_unsupported() -> None:
    with pytest.raises(Unsupported, match=r"cr_percent .*\d+ bytes, .* \d+ "):
        Jpeg2000.create(cr_percent=90).encode(GRAY[:9, :9])


def test_cr_percent_of_what_needs_less_is_coded_in_full() -> None:
    codec = Jpeg2000.create(cr_percent=1, irreversible=False)
    bitstream = codec.encode(GRAY)
    assert len(bitstream) < 0.95 * len(png_bytes(GRAY))  # which the search alone would not leave unused
    np.testing.assert_array_equal(codec.decode(bitstream), GRAY)
    assert len(bitstream) == len(Jpeg2000.create(lossless=True).encode(GRAY))


@IMAGES
def test_psnr_db_is_met(image: np.ndarray) -> None:
    codec = Jpeg2000.create(psnr_db=36)
    assert peak_signal_noise_ratio(image, codec.decode(codec.encode(image))) == pytest.approx(36, abs=1.5)


def test_the_irreversible_wavelet_is_the_default_and_better() -> None:
    psnr = []
    for irreversible in (True, False):
        codec = Jpeg2000.create(ratio=25, irreversible=irreversible)
        psnr.append(peak_signal_noise_ratio(PICTURE, codec.decode(codec.encode(PICTURE))))
    assert psnr[0] > psnr[1]
    assert Jpeg2000.create(ratio=25).params.irreversible


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"ratio": 8, "psnr_db": 30},
        {"lossless": True, "ratio": 8},
        {"lossless": True, "irreversible": True},
        {"lossless": False},
        {"ratio": 1},
        {"cr_percent": 100},
        {"ratio": 8, "layers": 0},
        {"ratio": 8, "layers": 17},
        {"psnr_db": 8, "layers": 4},
    ],
)
def test_anything_but_one_rate_is_refused(values: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        Jpeg2000.create(**values)


@pytest.mark.parametrize("shape", [(1, 1), (1, 1, 3), (1, 200), (31, 2, 3), (32, 33)])
def test_small_images_get_fewer_resolutions(shape: tuple[int, ...], rng: np.random.Generator) -> None:
    image = rng.integers(0, 256, shape, dtype=np.uint8)
    codec = Jpeg2000.create(lossless=True)
    np.testing.assert_array_equal(codec.decode(codec.encode(image)), image)


def test_every_cut_is_noticed() -> None:
    codec = Jpeg2000.create(ratio=20)
    bitstream = codec.encode(GRAY[:64, :64])
    for length in range(len(bitstream)):
        with pytest.raises(BitstreamError):
            codec.decode(bitstream[:length])


def test_every_changed_byte_is_noticed(rng: np.random.Generator) -> None:
    codec = Jpeg2000.create(ratio=20)
    bitstream = codec.encode(GRAY[:64, :64])
    for place in range(len(bitstream)):
        damaged = bitstream[:place] + bytes([bitstream[place] ^ int(rng.integers(1, 256))]) + bitstream[place + 1 :]
        with pytest.raises(BitstreamError):
            codec.decode(damaged)


def _sealed(bitstream: bytes) -> bytes:
    """A changed file with its checksum made right again."""
    place = bitstream.index(b"CRC-32: ") + 8
    crc = zlib.crc32(bitstream[place + 8 :], zlib.crc32(bitstream[:place]))
    return bitstream[:place] + b"%08x" % crc + bitstream[place + 8 :]


def test_a_header_that_claims_too_much_is_refused() -> None:
    bitstream = Jpeg2000.create(ratio=20).encode(GRAY)
    height, width = (size.to_bytes(4, "big") for size in GRAY.shape)
    huge = bitstream.replace(height, b"\0\0\xff\xff").replace(width, b"\0\0\xff\xff")
    with pytest.raises(BitstreamError, match="65535x65535"):
        Jpeg2000.create(ratio=20).decode(_sealed(huge))


LAYERED: list[dict[str, Any]] = [
    {"ratio": 8, "layers": 6},
    {"psnr_db": 38, "layers": 5},
    {"cr_percent": 60, "layers": 4},
    {"lossless": True, "layers": 6},
]


@IMAGES
@pytest.mark.parametrize("values", LAYERED, ids=str)
def test_layers_cost_little_and_keep_what_is_asked_for(image: np.ndarray, values: dict[str, Any]) -> None:
    layered, plain = Jpeg2000.create(**values), Jpeg2000.create(**{**values, "layers": 1})
    ours, theirs = layered.encode(image), plain.encode(image)
    assert ours != theirs
    assert len(ours) <= 1.05 * len(theirs)
    decoded, expected = layered.decode(ours), plain.decode(theirs)
    if layered.is_lossless():
        assert np.array_equal(decoded, image)
    else:
        assert peak_signal_noise_ratio(image, decoded) > peak_signal_noise_ratio(image, expected) - 0.5


def test_one_layer_is_what_it_was_before_there_was_a_choice() -> None:
    assert Jpeg2000.create(ratio=20).encode(GRAY) == Jpeg2000.create(ratio=20, layers=1).encode(GRAY)


@pytest.mark.parametrize("shape", [(1, 1), (3, 200), (17, 33, 3)])
def test_layers_of_small_images_have_room(shape: tuple[int, ...], rng: np.random.Generator) -> None:
    image = rng.integers(0, 256, shape, dtype=np.uint8)
    assert np.array_equal(Jpeg2000.create(lossless=True, layers=16).decode(
        Jpeg2000.create(lossless=True, layers=16).encode(image)), image)  # fmt: skip
    codec = Jpeg2000.create(ratio=30, layers=16)
    assert codec.decode(codec.encode(image)).shape == shape


@IMAGES
def test_the_beginning_of_layers_is_a_better_picture_than_that_of_one(image: np.ndarray) -> None:
    """A half, a quarter and an eighth of the bytes: within 3 dB of a file that was made for that size."""
    psnr = {}
    for layers in (1, 6):
        codec = Jpeg2000.create(ratio=6, layers=layers)
        bitstream = codec.encode(image)
        for share in (2, 4, 8):
            part = codec.decode_partial([Fragment(0, bitstream[: len(bitstream) // share])]).image
            psnr[layers, share] = peak_signal_noise_ratio(image, part)
    for share in (2, 4, 8):
        alone = Jpeg2000.create(ratio=6 * share)
        assert psnr[6, share] > peak_signal_noise_ratio(image, alone.decode(alone.encode(image))) - 3
    assert all(psnr[6, share] > psnr[1, share] + 1 for share in (2, 4, 8)), psnr


@IMAGES
def test_with_layers_no_byte_more_makes_a_picture_much_worse(image: np.ndarray) -> None:
    codec = Jpeg2000.create(ratio=8, layers=6)
    bitstream = codec.encode(image)
    ends = np.linspace(len(bitstream) // 20, len(bitstream) - 3, 40).astype(int)
    parts = [codec.decode_partial([Fragment(0, bitstream[:end])]).image for end in ends]
    quality = [float(peak_signal_noise_ratio(image, part)) for part in parts]
    assert all(after > before - 0.3 for before, after in pairwise(quality)), quality


@pytest.mark.thorough
@IMAGES
@pytest.mark.parametrize("layers", [1, 6])
def test_opj_decompress_makes_the_same_of_a_cut_file(image: np.ndarray, layers: int, tmp_path: Path) -> None:
    """Of the bytes as they are: with one layer cut anywhere behind the headers, with more where the last packet ends
    that a cut leaves whole."""
    codec = Jpeg2000.create(ratio=8, layers=layers)
    bitstream = codec.encode(image)
    headers = bitstream.index(b"\xff\x93") + 2
    for end in np.linspace(headers + 900, len(bitstream) - 3, 5).astype(int):
        file, _ = jp2_syntax.file_from_prefix(bitstream[:end])
        kept = len(file) - 2  # less EOC
        assert kept == end if layers == 1 else end - 6000 < kept <= end
        theirs = _opj_decompress(bitstream[:kept], tmp_path, "-allow-partial")
        np.testing.assert_array_equal(codec.decode_partial([Fragment(0, bitstream[:end])]).image, theirs)


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        (b"ihdr", b"bpcc", "image header"),
        (b"jp2c", b"uuid", "boxes"),
        (b"\xff\x52\x00\x0c\x00", b"\xff\x52\x00\x0c\x01", "coding style"),
        (b"\xff\x52\x00\x0c\x00\x00\x00\x01", b"\xff\x52\x00\x0c\x00\x00\xff\xff", "coding style"),
        (b"\xff\x5c", b"\xff\x5e", "FF5E"),
        (b"\xff\x90\x00\x0a\x00\x00", b"\xff\x90\x00\x0a\x00\x01", "tile 1"),
        (b"\xff\x93", b"\xff\x92", "SOD"),
        (b"\x07\x01\x01\xff\x52", b"\x07\x02\x02\xff\x52", "SIZ"),
    ],
)
def test_hostile_files_with_a_right_checksum_are_refused(old: bytes, new: bytes, reason: str) -> None:
    bitstream = Jpeg2000.create(ratio=20).encode(GRAY)
    assert old in bitstream
    with pytest.raises(BitstreamError, match=reason):
        Jpeg2000.create(ratio=20).decode(_sealed(bitstream.replace(old, new, 1)))


def test_lengths_of_packets_that_no_file_has_are_refused() -> None:
    bitstream = Jpeg2000.create(ratio=20, layers=3).encode(GRAY)
    place = bitstream.index(b"\xff\x58") + 5
    with pytest.raises(BitstreamError, match="PLT claims a packet"):
        Jpeg2000.create(ratio=20).decode(_sealed(bitstream[:place] + b"\xff" * 9 + bitstream[place + 9 :]))


def test_damage_inside_the_packets_with_a_right_checksum_neither_crashes_nor_raises(rng: np.random.Generator) -> None:
    codec = Jpeg2000.create(ratio=20)
    bitstream = codec.encode(GRAY)
    start = bitstream.index(b"\xff\x93") + 2
    refused = 0
    for _ in range(150):
        place = int(rng.integers(start, len(bitstream) - 30))
        noise = rng.integers(0, 256, 20, dtype=np.uint8).tobytes()
        try:
            decoded = codec.decode(_sealed(bitstream[:place] + noise + bitstream[place + 20 :]))
        except BitstreamError:
            refused += 1
        else:
            assert decoded.shape == GRAY.shape
    assert refused < 150


def test_scratch_files_are_in_the_temporary_folder_and_removed_also_on_failure(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    codec = Jpeg2000.create(ratio=20)
    bitstream = codec.encode(GRAY)
    written: list[Path] = []
    write = Path.write_bytes
    monkeypatch.setattr(Path, "write_bytes", lambda path, content: written.append(path) or write(path, content))
    codec.decode(bitstream)
    assert [path.parent.parent for path in written] == [tmp_path]
    with pytest.raises(TypeError):
        codec._write(GRAY, nonsense=1)
    packets = bitstream.index(b"\xff\x93") + 2
    reasons = []
    for seed in range(60):
        noise = np.random.default_rng(seed).bytes(20)
        try:
            codec.decode(_sealed(bitstream[:packets] + noise + bitstream[packets + 20 :]))
        except BitstreamError as error:
            reasons.append(str(error))
    assert any("OpenJPEG cannot read" in reason for reason in reasons)
    assert list(tmp_path.iterdir()) == []


_WITHOUT_SYSTEM_LIBRARY = """
import ctypes.util
find = ctypes.util.find_library
ctypes.util.find_library = lambda name: None if "openjp2" in name else find(name)
"""
_ROUND_TRIP = """
import numpy as np
from codecbench.plugins.codecs.jpeg2000 import Jpeg2000
image = np.arange(64 * 64, dtype=np.uint8).reshape(64, 64)
codec = Jpeg2000.create(lossless=True)
assert (codec.decode(codec.encode(image)) == image).all()
print(codec._glymur.lib.openjp2.OPENJP2._name)
"""


def _run(code: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "XDG_CONFIG_HOME": "/nonexistent"}
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=False)


def test_pillow_s_library_is_used_where_the_system_has_none() -> None:
    done = _run(_WITHOUT_SYSTEM_LIBRARY + _ROUND_TRIP)
    assert done.returncode == 0, done.stderr
    assert "pillow" in done.stdout


@pytest.mark.thorough
def test_pillow_s_library_is_used_also_where_glymur_was_imported_before() -> None:
    done = _run(_WITHOUT_SYSTEM_LIBRARY + "import glymur\n" + _ROUND_TRIP)
    assert done.returncode == 0, done.stderr
    assert "pillow" in done.stdout


def test_without_any_library_the_codec_is_unsupported_and_names_the_package() -> None:
    nothing = "from codecbench.plugins.codecs import openjpeg\nopenjpeg._bundled_libraries = lambda: []\n"
    done = _run(_WITHOUT_SYSTEM_LIBRARY + nothing + _ROUND_TRIP)
    assert done.returncode != 0
    assert "Unsupported" in done.stderr
    assert "apt install libopenjp2-7" in done.stderr


_PILLOW_S_FILE = """
import io, PIL.Image, skimage.data
from codecbench.plugins.codecs.jp2_syntax import insert_checksum
picture = np.ascontiguousarray(skimage.data.astronaut()[:120, :160])
for image, rate, own in (
    (picture, {"ratio": 12}, {"quality_mode": "rates", "quality_layers": [12], "irreversible": True, "mct": 1}),
    (picture[..., 1], {"psnr_db": 34}, {"quality_mode": "dB", "quality_layers": [34], "irreversible": True}),
    (picture, {"lossless": True}, {"irreversible": False, "mct": 1}),
):
    image = np.ascontiguousarray(image)
    stream = io.BytesIO()
    PIL.Image.fromarray(image).save(stream, "JPEG2000", num_resolutions=6, codeblock_size=(64, 64), **own)
    codec = Jpeg2000.create(**rate)
    assert codec.encode(image) == insert_checksum(stream.getvalue()), rate
    assert (codec.decode(codec.encode(image)) == np.asarray(PIL.Image.open(stream))).all(), rate
"""


@pytest.mark.thorough
def test_pillow_s_own_codec_writes_the_same_file_with_the_same_library() -> None:
    done = _run(_WITHOUT_SYSTEM_LIBRARY + _ROUND_TRIP + _PILLOW_S_FILE)
    assert done.returncode == 0, done.stderr


def test_libraries_are_recorded_with_the_version_that_openjpeg_writes_into_its_files(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(jpeg2000, "insert_checksum", lambda file: file)
    codec = Jpeg2000.create(ratio=8)
    file = codec.encode(GRAY)
    start = file.index(b"Created by OpenJPEG version ") + 28
    version = file[start : file.index(b"\xff", start)].decode()
    assert codec.libraries() == {"glymur": importlib.metadata.version("glymur"), "openjpeg": version}
