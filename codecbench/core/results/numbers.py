"""Numbers for people."""

from __future__ import annotations


def three_digits(value: float) -> str:
    """With three significant digits, and without an exponent up to a million: 1840 and not 1.84e+03."""
    return f"{float(f'{value:.3g}'):g}"
