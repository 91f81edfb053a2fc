"""Frames that were coded before they came here, so that `raw` is what another codec left of them."""

from __future__ import annotations

from typing import Final

from codecbench.plugins.codecs.jfif.quality import quality_from_jpeg

_JPEG_START: Final = b"\xff\xd8\xff"


def jpeg_notes(content: bytes) -> tuple[str, ...]:
    """What is to be said of pictures like the one in this file: nothing where it is no JPEG file."""
    if not content.startswith(_JPEG_START):
        return ()
    coded = quality_from_jpeg(content) or "JPEG"
    return (f"its frames are decoded {coded}: raw is what that left of them, and JPEG is at an advantage",)
