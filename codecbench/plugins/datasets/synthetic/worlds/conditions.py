"""Conditions of a synthetic scene, and their interpolation by severity."""

from __future__ import annotations

from dataclasses import dataclass, fields


@dataclass(frozen=True)
class Conditions:
    """One state of motion, light, sensor and surfaces."""

    speed_m_s: float = 0.7
    """Speed along the path."""
    turn_deg_s: float = 0.0
    """Angular speed of a camera that turns on the spot."""
    radius_m: float = 0.0
    """Radius of the turns."""
    tremor: float = 1.0
    """Factor on the amplitude of hand tremor."""
    exposure: float = 0.2
    """Exposure time as a share of the frame interval."""
    readout: float = 0.0
    """Share of the frame interval from the first row's exposure to the last row's; 0 is a global shutter."""
    electrons: float = 8000.0
    """Electrons in a white pixel; shot noise is their square root, and readout adds READ_NOISE_ELECTRONS."""
    brightness: float = 1.0
    """Brightness of white; 1 fills the range."""
    first_light: float = 1.0
    """Share of the light that is on in the first second."""
    swing_stops: float = 0.0
    """Amplitude of the exposure's oscillation."""
    lens_blur_px: float = 0.5
    """Standard deviation of the lens's blur."""
    contrast: float = 1.0
    """Factor on the contrast of all surfaces about their mean color."""
    distinctness: float = 1.0
    """Share by which repeated surfaces differ; at 0 all are alike."""


_RATIOS = ("electrons", "brightness", "first_light", "contrast")
"""Conditions that are interpolated geometrically; the others are interpolated linearly."""


def interpolate_conditions(calm: Conditions, hard: Conditions, severity: float) -> Conditions:
    """The conditions at a severity from 0 (`calm`) to 1 (`hard`); each changes monotonically."""
    values = {}
    for field in fields(Conditions):
        low, high = getattr(calm, field.name), getattr(hard, field.name)
        if field.name in _RATIOS:
            values[field.name] = low * (high / low) ** severity
        else:
            values[field.name] = low + (high - low) * severity
    return Conditions(**values)


def changing_conditions(calm: Conditions, hard: Conditions) -> dict[str, tuple[float, float]]:
    """The conditions that depend on severity, each at severity 0 and 1."""
    pairs = {field.name: (getattr(calm, field.name), getattr(hard, field.name)) for field in fields(Conditions)}
    return {name: pair for name, pair in pairs.items() if pair[0] != pair[1]}
