"""What makes a world easy or hard to see, as numbers between which severity moves."""

from __future__ import annotations

from dataclasses import dataclass, fields


@dataclass(frozen=True)
class Conditions:
    """One state of motion, light, sensor and surfaces.

    speed_m_s: along the path. turn_deg_s: how fast a camera on the spot turns. radius_m: of the turns. tremor: factor
    on a hand's. exposure: share of the frame interval. readout: share of the frame interval from the first row's
    exposure to the last row's; 0 is a global shutter. electrons: in a white pixel; shot noise is their square root,
    and reading out adds READ_NOISE_ELECTRONS. brightness: of white, 1 fills the range. first_light: share of the light
    that is there in the first second. swing_stops: by how much the exposure swings up and down. lens_blur_px: standard
    deviation of the lens's blur. contrast: of all surfaces about their mean colour. distinctness: share in which
    repeated surfaces differ, 0 is all alike.
    """

    speed_m_s: float = 0.7
    turn_deg_s: float = 0.0
    radius_m: float = 0.0
    tremor: float = 1.0
    exposure: float = 0.2
    readout: float = 0.0
    electrons: float = 8000.0
    brightness: float = 1.0
    first_light: float = 1.0
    swing_stops: float = 0.0
    lens_blur_px: float = 0.5
    contrast: float = 1.0
    distinctness: float = 1.0


_RATIOS = ("electrons", "brightness", "first_light", "contrast")
"""What is felt in ratios: these move by equal factors, the others by equal steps."""


def interpolate_conditions(calm: Conditions, hard: Conditions, severity: float) -> Conditions:
    """The conditions at a severity, 0 (`calm`) to 1 (`hard`); each number moves monotonically."""
    values = {}
    for field in fields(Conditions):
        low, high = getattr(calm, field.name), getattr(hard, field.name)
        if field.name in _RATIOS:
            values[field.name] = low * (high / low) ** severity
        else:
            values[field.name] = low + (high - low) * severity
    return Conditions(**values)


def changing_conditions(calm: Conditions, hard: Conditions) -> dict[str, tuple[float, float]]:
    """The numbers that severity moves, each at severity 0 and 1."""
    pairs = {field.name: (getattr(calm, field.name), getattr(hard, field.name)) for field in fields(Conditions)}
    return {name: pair for name, pair in pairs.items() if pair[0] != pair[1]}
