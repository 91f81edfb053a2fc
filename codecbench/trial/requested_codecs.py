"""Parser of codec settings on a command line, such as `jpeg:5..90` and `h264:crf=18..40,gop=30`."""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass
from itertools import islice, product
from typing import Any, Final

from codecbench.core.contracts.errors import CodecbenchError, ParamsError
from codecbench.core.engine.planning.description import InvalidParams, describe
from codecbench.core.engine.planning.schema import plugin_schema
from codecbench.core.engine.plugins.registry import Registry

_SPELLING: Final = "NAME, NAME:VALUE, NAME:FIRST..LAST or NAME:PARAM=..,PARAM=.., such as jpeg:5..90 or h264:crf=18..40"
_RANGE: Final = re.compile(r"(?P<first>-?[\d.]+?)\.\.(?P<last>-?\d+(?:\.\d+)?)(?:/(?P<count>\d+))?")
_MOST_CHECKED: Final = 1_000
"""How many settings of a codec are checked here; the matrix checks all."""
_FACTOR: Final = 4.0
"""A range whose ends differ by more than this factor has steps of equal ratio, others steps of equal size."""


@dataclass(frozen=True)
class RequestedCodec:
    """A codec requested for a matrix."""

    name: str
    values: dict[str, list[Any]]
    """Values of each parameter; all combinations are settings."""
    ranges: frozenset[str] = frozenset()
    """Parameters that were given as ranges."""

    @property
    def searched(self) -> bool:
        """Whether the values are those of a single range, of which a search tries some."""
        return {key for key, values in self.values.items() if len(values) > 1} == self.ranges and len(self.ranges) == 1

    def __len__(self) -> int:
        """Number of settings."""
        return math.prod(len(values) for values in self.values.values())


def parse_codec(registry: Registry, text: str, steps: int = 5) -> RequestedCodec:
    """Parse a `--codec` option. A value without a name belongs to the codec's first numeric parameter.

    steps: number of steps of a range without a count.

    Raises PluginError for an unknown codec and ParamsError for another spelling and for values that it does not take.
    """
    name, _, rest = text.partition(":")
    registry.find("codec", name)
    values: dict[str, list[Any]] = {}
    ranges: set[str] = set()
    for part in rest.split(",") if rest else []:
        key, equals, value = part.rpartition("=")
        key = key if equals else _first_number(registry, name)
        if not value or not key or key in values:
            raise ParamsError(f"--codec {text}: {part!r} is not understood; write {_SPELLING}")
        values[key] = _span(registry, name, key, value, steps)
        if _RANGE.fullmatch(value):
            ranges.add(key)
    _check_settings(registry, name, text, values)
    return RequestedCodec(name, values, frozenset(ranges))


def _check_settings(registry: Registry, name: str, text: str, values: dict[str, list[Any]]) -> None:
    """Raise ParamsError with the words of the command line if the codec rejects a setting."""
    last = tuple(span[-1] for span in values.values())  # the end of a range first: that is what was written
    for chosen in [last, *islice(product(*values.values()), _MOST_CHECKED)] if values else []:
        try:
            describe(registry, "codec", name, dict(zip(values, chosen, strict=True)))
        except InvalidParams as invalid:
            raise ParamsError(f"--codec {text}: {invalid.sentence}") from None
        except CodecbenchError:
            return  # the matrix reports what is missing here


def _span(registry: Registry, codec: str, key: str, text: str, steps_wanted: int) -> list[Any]:
    """Return the values of `5..90`, `5..90/7`, `5|10|20` or a single value."""
    match = _RANGE.fullmatch(text)
    if match is None:
        is_text = _json_types(registry, codec, key) - {""} == {"string"}
        return [word if is_text else _value(word) for word in text.split("|")]
    try:
        first, last = float(match["first"]), float(match["last"])
    except ValueError:
        raise ParamsError(f"--codec {codec}: {text!r} is not a range; write FIRST..LAST, such as 5..90") from None
    count = int(match["count"] or steps_wanted)
    if not 2 <= count <= 100:
        raise ParamsError(f"--codec {codec}: {text!r} has {count} steps; 2 to 100 are possible")
    low, high = sorted((first, last))
    ratios = key != "quality" and low > 0 and high / low > _FACTOR  # a quality is no amount of anything
    steps = [low * (high / low) ** (i / (count - 1)) if ratios else low + (high - low) * i / (count - 1)
             for i in range(count)]  # fmt: skip
    whole = "integer" in _json_types(registry, codec, key) or (
        low.is_integer() and high.is_integer() and high - low >= count
    )
    values = list(dict.fromkeys(round(step) if whole else float(f"{step:.4g}") for step in steps))
    return values if first == low else values[::-1]


def _value(word: str) -> Any:
    try:
        return json.loads(word)
    except ValueError:
        return word


def _first_number(registry: Registry, codec: str) -> str:
    """Return the codec's first numeric parameter."""
    properties = plugin_schema(registry, f"codec:{codec}").get("properties", {})
    for key in properties:
        if _json_types(registry, codec, key) & {"integer", "number"}:
            return str(key)
    raise ParamsError(f"--codec {codec}: it has no numeric parameter; see `codecbench schema codec:{codec}`")


def _json_types(registry: Registry, codec: str, key: str) -> set[str]:
    """Return the JSON types of a parameter."""
    described = plugin_schema(registry, f"codec:{codec}").get("properties", {}).get(key, {})
    return {str(choice.get("type", "")) for choice in [described, *described.get("anyOf", [])]}
