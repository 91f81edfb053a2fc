"""The sections of a matrix that name a metric and a target value, before the metric is resolved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import pairwise
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, StrictFloat, StrictInt, ValidationError, model_validator

from codecbench.core.engine.planning.axes import Axis
from codecbench.core.engine.planning.yaml_file import Problems, Where, format_value, plain_value

Bound = Literal["min", "max", "equal"]

_BOUNDS: Final[tuple[Bound, ...]] = ("min", "max", "equal")
_Number = Annotated[StrictInt | StrictFloat, Field(allow_inf_nan=False)]
PASSES: Final = "passes"
"""Value of `search` that asks for the coarsest setting that passes what is asked of the run."""
_MISSING_EXTRA: Final = "a search over several parameters needs optuna; run: pip install 'codecbench[search]'"


class ObjectiveSection(BaseModel):
    """A metric and its target value: `metric` with one of `min`, `max` and `equal`."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    metric: str = Field(description="[EVALUATOR.]METRIC[.STAGE][.AGGREGATE], as in the table's column names")
    min: _Number | None = Field(default=None, description="the minimum value")
    max: _Number | None = Field(default=None, description="the maximum value")
    equal: _Number | None = Field(default=None, description="the value to reach as closely as possible")

    @model_validator(mode="after")
    def _one_bound(self) -> ObjectiveSection:
        given = [name for name in _BOUNDS if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"needs one of min, max and equal; got {' and '.join(given) or 'none'}")
        return self

    @property
    def bound(self) -> Bound:
        return next(name for name in _BOUNDS if getattr(self, name) is not None)


class SearchSection(ObjectiveSection):
    """The `search:` of a codec entry."""

    within: float = Field(default=0.0, ge=0, description="tolerance around `equal`, in the metric's unit")
    budget: int = Field(default=50, ge=1, le=100_000, description="maximum number of settings tried on a sequence")


@dataclass(frozen=True)
class SearchSpec:
    """The `search` or `at` of an entry, before its metric is resolved."""

    where: Where
    """Position in the file."""
    section: SearchSection | None
    """None if the search is for a setting that passes."""
    axes: tuple[Axis, ...]


def read_section(kind: type[Any], value: Any, where: Where, problems: Problems) -> Any:
    """Validate a section as its model; if it is invalid, note problems and return None."""
    if not isinstance(value, Mapping):
        example = "{metric: NAME, min: NUMBER}" if where[-1] != "at" else "{METRIC: NUMBER}"
        example += f", or {PASSES}" if where[-1] == "search" else ""
        problems.add(where, f"must be a mapping such as {example}; got {plain_value(value)}")
        return None
    problems.unknown(where, value, kind.model_fields)
    if any(key not in kind.model_fields for key in value):
        return None
    try:
        return kind.model_validate(plain_value(value))
    except ValidationError as error:
        for detail in error.errors():
            message = str(detail["msg"]).removeprefix("Value error, ")
            suffix = "" if isinstance(detail["input"], Mapping) else f"; got {format_value(detail['input'])}"
            path = [part for part in detail["loc"] if part in kind.model_fields]
            problems.add((*where, *path), message + suffix)
        return None


def read_search_spec(
    item: Mapping[str, Any], where: Where, axes: Sequence[Axis], problems: Problems
) -> SearchSpec | None:
    """Read the `search` or `at` of a codec entry; if it is invalid, note a problem and return None."""
    word = "search" if "search" in item else "at"
    place = (*where, word)
    if "search" in item and "at" in item:
        problems.add((*where, "at"), "is short for `search`, which this entry also has; leave out one of the two")
        return None
    value = _from_short_form(item[word]) if word == "at" else item[word]
    passes = word == "search" and value == PASSES
    section = None if passes else read_section(SearchSection, value, place, problems)
    varied = tuple(axis for axis in axes if len(axis) > 1)
    if not varied:
        message = "a search needs a parameter with several values: `{range: [first, last, step]}` or `{grid: [...]}`"
        problems.add(place, message)
        return None
    for axis in varied:
        _require_ordered(axis, (*where, "params", axis.name), problems)
    if len(varied) > 1 and passes:
        problems.add(place, f"only one parameter may vary; got {' and '.join(axis.name for axis in varied)}")
        return None
    if len(varied) > 1 and find_spec("optuna") is None:
        problems.add(place, _MISSING_EXTRA)
    return None if section is None and not passes else SearchSpec(place, section, varied)


def _from_short_form(value: Any) -> Any:
    """Convert `{rate_bpp: 0.5}` to `{metric: rate_bpp, equal: 0.5}`."""
    if isinstance(value, Mapping) and len(value) == 1:
        ((metric, number),) = value.items()
        return {"metric": metric, "equal": number}
    return format_value(value)


def _require_ordered(axis: Axis, where: Where, problems: Problems) -> None:
    """Note a problem if the numbers are not monotonic or a value occurs twice."""
    values = [value for _, value in axis.choices]
    numbers = [value for value in values if isinstance(value, int | float) and not isinstance(value, bool)]
    steps = list(pairwise(numbers))
    if not (all(a < b for a, b in steps) or all(a > b for a, b in steps)):
        problems.add(where, "a search needs ascending or descending values; these are neither")
    elif len({repr(value) for value in values}) < len(values):
        problems.add(where, "a search needs distinct values; one of these occurs twice")
