"""What a sentence tells, without its wording."""

from __future__ import annotations

import re


def numbers(text: str) -> list[float]:
    """The numbers of a text in their order, with thousands in groups or not; digits in names such as `k1` are none."""
    return [float(found.replace(",", "")) for found in re.findall(r"(?<![\w.])-?\d+(?:,\d{3})*(?:\.\d+)?", text)]
