"""The settings under which every installed codec is checked."""

from __future__ import annotations

from typing import Any

SETTINGS: dict[str, list[dict[str, Any]]] = {
    "raw": [{}],
    "png": [{}, {"effort": 9}],
    "jpeg": [
        {},
        {"quality": 1, "subsampling": "444", "optimize": True},
        {"quality": 100, "subsampling": "422"},
        {"progressive": True},
    ],
    "jpeg_qf": [
        {"qf": 5},
        {"qf": 100, "optimize": True, "color": "ycbcr420"},
        {"qf": 0.01, "table": "standard", "color": "ycbcr420"},
        {"qf": 20, "color": "gray"},
    ],
    "jpeg2000": [
        {"ratio": 8},
        {"psnr_db": 35},
        {"lossless": True},
        {"cr_percent": 60, "irreversible": False},
    ],
    "multilevel": [
        {},
        {"qf": 20, "levels": 2, "decoding": "search", "color": "ycbcr420"},
        {"qf": 75, "keys": "random", "seed": 3, "scan": "coefficient", "table": "standard"},
    ],
    "jpegxl": [{}, {"distance": 0}],
    "jpegls": [{}, {"near": 3}],
    "htj2k": [{}, {"step": 0}],
    "webp": [{}, {"lossless": True}],
    "avif": [{}, {"subsampling": "444", "quality": 90}],
}
"""By name; a codec that is not listed is checked at its defaults."""


def settings_of(name: str) -> list[dict[str, Any]]:
    return SETTINGS.get(name, [{}])


def label(name: str, setting: dict[str, Any]) -> str:
    """A test's name for a setting: `jpeg quality=5`."""
    return "-".join([name, *(f"{key}={value}" for key, value in setting.items())])
