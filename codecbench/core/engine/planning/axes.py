"""Expand the axes of a `params` mapping: `{grid: [...]}` and `{range: [first, last, step]}`."""

from __future__ import annotations

import difflib
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from codecbench.core.engine.planning.yaml_file import Problems, Where, format_value, plain_value

MOST_SETTINGS: Final = 100_000
"""Maximum number of settings that one entry of a matrix may span."""
_MOST_STEPS: Final = 10_000
_AXES: Final = ("grid", "range")

Point = dict[str, tuple[Where, Any]]
"""Value of each parameter, with its position in the file."""


@dataclass(frozen=True)
class Axis:
    """A parameter and its values; a parameter that is not swept has one value."""

    name: str
    choices: tuple[tuple[Where, Any], ...]
    """Each value with its position in the file."""

    def __len__(self) -> int:
        return len(self.choices)


def axes(params: Mapping[str, Any], where: Where, problems: Problems) -> list[Axis]:
    """Return the axes of a `params` mapping; note a problem and return an empty axis if they span too many settings."""
    result = []
    for key, value in params.items():
        place = (*where, key)
        choices = _axis(value, place, problems) if _is_axis(value) else [(place, plain_value(value))]
        result.append(Axis(str(key), tuple(choices)))
    count = math.prod(len(axis) for axis in result)
    if count > MOST_SETTINGS:
        lengths = " x ".join(str(len(axis)) for axis in result if len(axis) > 1)
        problems.add(where, f"{lengths} = {count:,} settings; at most {MOST_SETTINGS:,} are allowed")
        return [Axis("", ())]
    return result


def points(spanned: Sequence[Axis]) -> Iterator[Point]:
    """Yield every combination of the axes' values; the last axis varies fastest."""
    for combination in itertools.product(*(axis.choices for axis in spanned)):
        yield {axis.name: choice for axis, choice in zip(spanned, combination, strict=True)}


def axis_hint(name: str, value: Any) -> str:
    """Explain how to write an axis if a rejected value looks like an attempt at one; otherwise return ""."""
    if isinstance(value, list):
        return f"; to plan a setting for each, write `{name}: {{grid: {format_value(value)}}}`"
    if not (isinstance(value, Mapping) and len(value) == 1):
        return ""
    ((kind, choices),) = value.items()
    near = difflib.get_close_matches(str(kind).lower(), _AXES, n=1)
    if not near or not isinstance(choices, list):
        return ""
    return f"; did you mean `{name}: {{{near[0]}: {format_value(choices)}}}`?"


def _is_axis(value: Any) -> bool:
    return isinstance(value, Mapping) and len(value) == 1 and next(iter(value)) in _AXES


def _axis(axis: Mapping[str, Any], where: Where, problems: Problems) -> list[tuple[Where, Any]]:
    """Return the values of an axis with their positions; a range includes its last value."""
    ((kind, choices),) = axis.items()
    place = (*where, kind)
    if not isinstance(choices, list) or not choices:
        problems.add(place, f"must be a list; got {format_value(choices)}")
    elif kind == "grid":
        return [((*place, index), plain_value(choice)) for index, choice in enumerate(choices)]
    else:
        steps = _steps(plain_value(choices))
        if steps is None:
            allowed = f"[first, last, step > 0], 1 to {_MOST_STEPS} values"
            problems.add(place, f"must be {allowed}; got {format_value(choices)}")
        else:
            return [(place, number) for number in steps]
    return []


def _steps(choices: list[Any]) -> list[float] | None:
    """Return the numbers of `[first, last]` or `[first, last, step]`, or None if the list is invalid or too long."""
    if len(choices) not in (2, 3) or not all(isinstance(number, int | float) for number in choices):
        return None
    first, last, step = [*choices, 1][:3]
    if not step > 0 or not all(math.isfinite(number) for number in (first, last, step, (last - first) / step)):
        return None
    count = int((last - first) / step + 1e-9) + 1
    return [first + step * index for index in range(count)] if 1 <= count <= _MOST_STEPS else None
