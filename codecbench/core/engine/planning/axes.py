"""The axes of a `params` mapping, `{grid: [...]}` and `{range: [first, last, step]}`, and what they span."""

from __future__ import annotations

import difflib
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from codecbench.core.engine.planning.yaml_file import Problems, Where, format_value, plain_value

MOST_SETTINGS: Final = 100_000
"""That one entry of a matrix may stand for."""
_MOST_STEPS: Final = 10_000
_AXES: Final = ("grid", "range")

Point = dict[str, tuple[Where, Any]]
"""A value for each parameter, with its place in the file."""


@dataclass(frozen=True)
class Axis:
    """A parameter and the values that it takes, each with its place in the file; one value where it is no axis."""

    name: str
    choices: tuple[tuple[Where, Any], ...]

    def __len__(self) -> int:
        return len(self.choices)


def axes(params: Mapping[str, Any], where: Where, problems: Problems) -> list[Axis]:
    """The axes of a `params` mapping; none, and a problem, where they span too many settings."""
    found = []
    for key, value in params.items():
        place = (*where, key)
        choices = _axis(value, place, problems) if _is_axis(value) else [(place, plain_value(value))]
        found.append(Axis(str(key), tuple(choices)))
    count = math.prod(len(axis) for axis in found)
    if count > MOST_SETTINGS:
        lengths = " x ".join(str(len(axis)) for axis in found if len(axis) > 1)
        problems.add(where, f"{lengths} = {count:,} settings; at most {MOST_SETTINGS:,} are planned")
        return [Axis("", ())]
    return found


def points(spanned: Sequence[Axis]) -> Iterator[Point]:
    """Every combination of the values of axes, the last axis turning fastest."""
    for combination in itertools.product(*(axis.choices for axis in spanned)):
        yield {axis.name: choice for axis, choice in zip(spanned, combination, strict=True)}


def axis_hint(name: str, value: Any) -> str:
    """How an axis is written, where a value that its parameter does not take was meant as one; else empty."""
    if isinstance(value, list):
        return f"; for a setting of each of these write `{name}: {{grid: {format_value(value)}}}`"
    if not (isinstance(value, Mapping) and len(value) == 1):
        return ""
    ((word, choices),) = value.items()
    near = difflib.get_close_matches(str(word).lower(), _AXES, n=1)
    if not near or not isinstance(choices, list):
        return ""
    return f"; did you mean `{name}: {{{near[0]}: {format_value(choices)}}}`?"


def _is_axis(value: Any) -> bool:
    return isinstance(value, Mapping) and len(value) == 1 and next(iter(value)) in _AXES


def _axis(value: Mapping[str, Any], where: Where, problems: Problems) -> list[tuple[Where, Any]]:
    """The places and values of an axis; of a range the last included."""
    ((word, choices),) = value.items()
    place = (*where, word)
    if not isinstance(choices, list) or not choices:
        problems.add(place, f"must be a list; got {format_value(choices)}")
    elif word == "grid":
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
    """The numbers of `[first, last]` or `[first, last, step]`, or None where these are none or too many."""
    if len(choices) not in (2, 3) or not all(isinstance(number, int | float) for number in choices):
        return None
    first, last, step = [*choices, 1][:3]
    if not step > 0 or not all(math.isfinite(number) for number in (first, last, step, (last - first) / step)):
        return None
    count = int((last - first) / step + 1e-9) + 1
    return [first + step * index for index in range(count)] if 1 <= count <= _MOST_STEPS else None
