"""Samples of every encoding become the pictures that they were made of."""

from __future__ import annotations

import io
import re
import struct
import zlib

import cv2
import numpy as np
import pytest
from bag_files import BagWriter, picture, time_ns
from PIL import Image as PillowImage

from codecbench.core.contracts.errors import DatasetError
from codecbench.plugins.datasets.bag.dataset import Bag
from codecbench.plugins.datasets.bag.images import bits_of

RGB = picture(1, (24, 32, 3))
GRAY = picture(2, (24, 32))
ALPHA = np.full((24, 32, 1), 7, np.uint8)
DEEP = np.random.default_rng(3).integers(0, 1 << 16, (24, 32), dtype=np.uint16)
DEEP_RGB = np.random.default_rng(4).integers(0, 1 << 16, (24, 32, 3), dtype=np.uint16)
FLAT = np.tile(np.array([200, 90, 30], np.uint8), (24, 32, 1))
BAYER = {"rggb": (0, 1, 1, 2), "bggr": (2, 1, 1, 0), "gbrg": (1, 2, 0, 1), "grbg": (1, 0, 2, 1)}


def opened(tmp_path, make, **values):
    path = tmp_path / "a.bag"
    path.unlink(missing_ok=True)
    with BagWriter(path, "bag") as bag:
        bag.write("/image", make(bag), time_ns(0))
    return Bag.create(path=path, **values).open()


def error(tmp_path, make, **values):
    with pytest.raises(DatasetError) as caught:
        opened(tmp_path, make, **values)
    return str(caught.value)


@pytest.mark.parametrize("padding", [0, 5])
@pytest.mark.parametrize(
    ("encoding", "samples", "expected"),
    [
        ("mono8", GRAY, GRAY),
        ("8UC1", GRAY, GRAY),
        ("rgb8", RGB, RGB),
        ("bgr8", RGB[:, :, ::-1], RGB),
        ("8UC3", RGB[:, :, ::-1], RGB),
        ("rgba8", np.concatenate([RGB, ALPHA], axis=2), RGB),
        ("bgra8", np.concatenate([RGB[:, :, ::-1], ALPHA], axis=2), RGB),
    ],
)
def test_eight_bits_are_kept(tmp_path, encoding, samples, expected, padding):
    sequence = opened(tmp_path, lambda bag: bag.image(samples, encoding, time_ns(0), padding))
    np.testing.assert_array_equal(sequence.read(0).image, expected)
    assert len(sequence.notes) == 2  # the topic, and that there is no camera


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize(("encoding", "samples"), [("mono16", DEEP), ("16UC1", DEEP), ("rgb16", DEEP_RGB)])
def test_sixteen_bits_become_their_upper_eight(tmp_path, encoding, samples, big):
    sequence = opened(tmp_path, lambda bag: bag.image(samples, encoding, time_ns(0), 2, big))
    np.testing.assert_array_equal(sequence.read(0).image, samples // 256)
    assert re.findall(r"\d+", sequence.notes[1]) == ["16", "8", "8", "15", "16", str(samples.max())]


def test_samples_of_twelve_bits_become_the_upper_eight_of_these(tmp_path):
    samples = DEEP // 16
    samples[0, 0], samples[0, 1] = 4095, 5000
    sequence = opened(tmp_path, lambda bag: bag.image(samples, "mono16", time_ns(0)), bits=12)
    expected = samples // 16
    expected[0, 1] = 255
    np.testing.assert_array_equal(sequence.read(0).image, expected)
    samples[0, 1] = 7
    sequence = opened(tmp_path, lambda bag: bag.image(samples, "mono16", time_ns(0)))
    assert re.findall(r"\d+", sequence.notes[1]) == ["16", "8", "8", "15", "16", "4095", "12"]
    assert "`bits: 12`" in sequence.notes[1]
    assert sequence.origin.params == {"bits": 12}


@pytest.mark.parametrize(("largest", "bits"), [(0, 8), (255, 8), (256, 10), (1900, 12), (4096, 14), (65535, 16)])
def test_a_camera_has_an_even_number_of_bits(largest, bits):
    assert bits_of(largest) == bits


def mosaic(image, order):
    samples = np.empty(image.shape[:2], image.dtype)
    for place, channel in enumerate(BAYER[order]):
        row, column = divmod(place, 2)
        samples[row::2, column::2] = image[row::2, column::2, channel]
    return samples


def interpolated(samples, order):
    """Each channel's own samples, and between them the mean of the nearest (1-2-1 across and down)."""
    kernel = np.outer([1, 2, 1], [1, 2, 1]) / 4
    made = []
    for channel in range(3):
        known = np.zeros(samples.shape)
        for place, of in enumerate(BAYER[order]):
            row, column = divmod(place, 2)
            known[row::2, column::2] = of == channel
        total = cv2.filter2D(samples * known, -1, kernel, borderType=cv2.BORDER_CONSTANT)
        weight = cv2.filter2D(known, -1, kernel, borderType=cv2.BORDER_CONSTANT)
        made.append(np.where(known, samples, total / weight))
    return np.stack(made, axis=2)


@pytest.mark.parametrize("order", BAYER)
def test_bayer_pictures_are_interpolated_bilinearly(tmp_path, order):
    samples = mosaic(picture(5), order)
    sequence = opened(tmp_path, lambda bag: bag.image(samples, f"bayer_{order}8", time_ns(0)))
    image = sequence.read(0).image
    assert sequence.channels == 3
    inner = (slice(2, -2), slice(2, -2))
    np.testing.assert_allclose(image[inner], interpolated(samples, order)[inner], atol=1.01)
    assert any(note.startswith(f"bayer_{order}8 ") and "bilinear" in note for note in sequence.notes)
    deep = opened(tmp_path, lambda bag: bag.image(samples.astype(np.uint16) * 256, f"bayer_{order}16", time_ns(0)))
    np.testing.assert_array_equal(deep.read(0).image, image)


@pytest.mark.parametrize("order", BAYER)
def test_a_flat_color_survives_its_mosaic(tmp_path, order):
    sequence = opened(tmp_path, lambda bag: bag.image(mosaic(FLAT, order), f"bayer_{order}8", time_ns(0)))
    np.testing.assert_array_equal(sequence.read(0).image, FLAT)


@pytest.mark.parametrize(("encoding", "place"), [("yuv422", 1), ("yuv422_yuy2", 0)])
def test_yuv_with_halved_chroma(tmp_path, encoding, place):
    samples = np.full((24, 32, 2), 128, np.uint8)
    luma = picture(6, (24, 32)) // 2 + 60
    samples[:, :, place] = luma
    image = opened(tmp_path, lambda bag: bag.image(samples, encoding, time_ns(0))).read(0).image
    expected = np.clip((luma.astype(float) - 16) * 255 / 219, 0, 255)
    np.testing.assert_allclose(image, np.repeat(expected[:, :, None], 3, axis=2), atol=1)


@pytest.mark.parametrize(("encoding", "blue"), [("nv12", 0), ("nv21", 1)])
def test_yuv_with_quartered_chroma(tmp_path, encoding, blue):
    samples = np.full((36, 32), 128, np.uint8)
    samples[:24] = luma = picture(6, (24, 32)) // 2 + 60
    samples[24:, blue::2] = 168

    def make(bag):
        message = bag.image(samples, encoding, time_ns(0))
        message.height = 24
        return message

    expected = (luma[:, :, None] - 16.0) * 255 / 219 + np.array([0.0, -0.391, 2.018]) * 40  # BT.601
    np.testing.assert_allclose(opened(tmp_path, make).read(0).image, np.clip(expected, 0, 255), atol=1.5)


def test_an_encoding_that_is_not_read_lists_those_that_are(tmp_path):
    said = error(tmp_path, lambda bag: bag.image(np.zeros((4, 4, 2), np.float32), "32FC2", time_ns(0)))
    assert re.search(r"/image\[0\]: .*'32FC2'.*: 16UC1, ", said)


@pytest.mark.parametrize("wrong", [{"width": 33}, {"height": 25}, {"step": 5}, {"width": 1 << 31}, {"height": 0}])
def test_sizes_that_do_not_fit_the_data_are_refused(tmp_path, wrong):
    def make(bag):
        message = bag.image(RGB, "rgb8", time_ns(0))
        for name, value in wrong.items():
            setattr(message, name, value)
        return message

    assert "fit 2304 bytes" in error(tmp_path, make)


def test_a_single_row_may_claim_any_step(tmp_path):
    def make(bag):
        message = bag.image(RGB[:1], "rgb8", time_ns(0))
        message.step = (1 << 32) - 1
        return message

    np.testing.assert_array_equal(opened(tmp_path, make).read(0).image, RGB[:1])


def encoded(image, extension, *options):
    done, content = cv2.imencode(extension, image if image.ndim == 2 else image[:, :, ::-1], options)
    assert done
    return content.tobytes()


@pytest.mark.parametrize("quality", [5, 30, 75, 95])
def test_jpeg_images_are_decoded_and_a_note_gives_their_quality(tmp_path, quality):
    content = encoded(RGB, ".jpg", cv2.IMWRITE_JPEG_QUALITY, quality)
    sequence = opened(tmp_path, lambda bag: bag.compressed_image(content, "rgb8; jpeg compressed bgr8", time_ns(0)))
    expected = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)[:, :, ::-1]
    np.testing.assert_array_equal(sequence.read(0).image, expected)
    for fact in ("ALREADY CODED", " rgb8; jpeg compressed bgr8 ", f", JPEG of quality {quality} (", "`raw`"):
        assert fact in sequence.notes[1]


def test_gray_jpeg_pictures_stay_gray(tmp_path):
    content = encoded(GRAY, ".jpg")
    sequence = opened(tmp_path, lambda bag: bag.compressed_image(content, "mono8; jpeg compressed ", time_ns(0)))
    assert (sequence.channels, sequence.read(0).image.shape) == (1, (24, 32))


def test_png_pictures_lose_nothing(tmp_path):
    for image in (RGB, GRAY):
        content = encoded(image, ".png")
        sequence = opened(tmp_path, lambda bag, c=content: bag.compressed_image(c, "png", time_ns(0)))
        np.testing.assert_array_equal(sequence.read(0).image, image)
        assert any("is lossless" in note for note in sequence.notes)


def as_file(image, kind, **options):
    stream = io.BytesIO()
    PillowImage.fromarray(image).save(stream, kind, **options)
    return stream.getvalue()


@pytest.mark.parametrize(("kind", "options"), [("AVIF", {"quality": 60}), ("JPEG2000", {}), ("WEBP", {"quality": 60})])
def test_other_pictures_are_those_that_pillow_decodes(tmp_path, kind, options):
    content = as_file(RGB, kind, **options)
    sequence = opened(tmp_path, lambda bag: bag.compressed_image(content, kind.lower(), time_ns(0)))
    np.testing.assert_array_equal(sequence.read(0).image, PillowImage.open(io.BytesIO(content)))
    assert f"ALREADY CODED: the topic has {kind.lower()} images" in sequence.notes[1]
    for cut in (3, len(content) // 2):
        said = error(tmp_path, lambda bag, c=cut: bag.compressed_image(content[:-c], kind.lower(), time_ns(0)))
        assert re.search("cannot be decoded|contains no image", said)


def test_png_pictures_of_16_bits_and_of_a_mosaic(tmp_path):
    content = encoded(DEEP, ".png")
    sequence = opened(tmp_path, lambda bag: bag.compressed_image(content, "mono16; png compressed ", time_ns(0)))
    np.testing.assert_array_equal(sequence.read(0).image, DEEP // 256)
    flat = encoded(mosaic(FLAT, "grbg"), ".png")
    sequence = opened(tmp_path, lambda bag: bag.compressed_image(flat, "bayer_grbg8; png compressed ", time_ns(0)))
    np.testing.assert_array_equal(sequence.read(0).image, FLAT)


def png_of_size(width, height):
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", zlib.compress(bytes(100))) + chunk(b"IEND", b"")


@pytest.mark.parametrize(
    ("content", "format_", "words"),
    [
        (b"", "jpeg", "contains no image"),
        (b"\xff\xd8\xff nothing", "jpeg", "contains no image"),
        (encoded(RGB, ".jpg")[:-300], "jpeg", "is cut short"),
        (png_of_size(20_000, 8_000), "png", "20000x8000; at most 67108864 "),
        (png_of_size(200_000, 80_000), "png", "contains no image"),
        (encoded(DEEP, ".png")[:9], "16UC1; compressedDepth png", "9 bytes of '16UC1; compressedDepth png' are not"),
        (bytes(12) + encoded(DEEP, ".png")[:-300], "16UC1; compressedDepth png", "hold no whole 16-bit depth image"),
        (bytes(12) + encoded(GRAY, ".png"), "16UC1; compressedDepth png", "hold no whole 16-bit depth image"),
        (bytes(40), "16UC1; compressedDepth rvl", "its depth cannot be decoded: rvl: "),
    ],
)
def test_compressed_pictures_that_cannot_be_read(tmp_path, content, format_, words):
    assert words in error(tmp_path, lambda bag: bag.compressed_image(content, format_, time_ns(0)))


def test_a_frame_of_another_size_is_an_error_of_that_frame(tmp_path):
    path = tmp_path / "a.bag"
    with BagWriter(path, "bag") as bag:
        bag.write("/image", bag.image(RGB, "rgb8", time_ns(0)), time_ns(0))
        bag.write("/image", bag.image(RGB[:20], "rgb8", time_ns(1)), time_ns(1))
    with pytest.raises(DatasetError, match=r"/image\[1\]: .* 32x20, color, .* 32x24, color"):
        Bag.create(path=path).open().read(1)
