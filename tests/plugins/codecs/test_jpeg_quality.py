"""The quality of JPEG files by their tables, against libjpeg that wrote them."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image as PillowImage

from codecbench.plugins.codecs.jfif import JpegQuality, libjpeg_steps, quality_from_jpeg

PICTURE = PillowImage.fromarray(np.random.default_rng(0).integers(0, 256, (16, 16, 3), dtype=np.uint8))


def jpeg(**options):
    stream = io.BytesIO()
    PICTURE.save(stream, "JPEG", **options)
    return stream.getvalue()


@pytest.mark.parametrize("quality", [1, 5, 24, 25, 26, 49, 50, 51, 75, 90, 99, 100])
def test_the_quality_of_libjpegs_files_is_read_exactly(quality):
    assert quality_from_jpeg(jpeg(quality=quality)) == JpegQuality(quality, is_exact=True)


def test_steps_are_libjpegs():
    for quality in (3, 40, 80):
        with PillowImage.open(io.BytesIO(jpeg(quality=quality))) as opened:
            natural = opened.quantization[0]
        assert sorted(natural) == sorted(libjpeg_steps(quality).tolist())


def test_other_tables_get_the_nearest_quality():
    steps = (libjpeg_steps(60) + np.arange(64) % 2).tolist()
    found = quality_from_jpeg(jpeg(qtables=[steps, steps]))
    assert not found.is_exact
    assert abs(found.quality - 60) <= 3
    assert "about quality" in str(found)


@pytest.mark.parametrize("content", [b"", b"\xff\xd8\xff\xd9", b"\x89PNG", jpeg()[:100]])
def test_what_has_no_table_has_no_quality(content):
    assert quality_from_jpeg(content) is None
