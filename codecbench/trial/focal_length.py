"""The field of view that a camera noted in its pictures."""

from __future__ import annotations

import math
from pathlib import Path

from PIL import ExifTags, Image, UnidentifiedImageError

_FILM_WIDTH_MM = 36.0


def fov_deg_of(path: Path) -> float | None:
    """The horizontal field of view in degrees by the first picture of a folder that notes its focal length in EXIF.

    That is the focal length on film of 36 mm width which sees as much; None where no picture says it.
    """
    if not path.is_dir():
        return None
    for file in sorted(path.iterdir())[:3]:
        try:
            with Image.open(file) as picture:
                noted = picture.getexif().get_ifd(ExifTags.IFD.Exif).get(ExifTags.Base.FocalLengthIn35mmFilm)
        except (OSError, UnidentifiedImageError, ValueError, SyntaxError, Image.DecompressionBombError):
            continue
        if isinstance(noted, int) and 5 <= noted <= 2000:
            return round(math.degrees(2 * math.atan(_FILM_WIDTH_MM / 2 / noted)), 1)
    return None
