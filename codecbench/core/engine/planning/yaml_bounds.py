"""What a YAML file may ask of memory and time, found out from its grammar alone, before anything is built."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError
from ruamel.yaml.events import (
    AliasEvent,
    CollectionEndEvent,
    CollectionStartEvent,
    Event,
    MappingStartEvent,
    NodeEvent,
    ScalarEvent,
)
from ruamel.yaml.scanner import Scanner

from codecbench.core.contracts.errors import MatrixError

MOST_CHARACTERS: Final = 1_000_000
_MOST_VALUES: Final = 20_000
"""With those that an alias repeats: `*name` counts as much as what it stands for."""
_DEEPEST: Final = 64
_TOO_DEEP: Final = f"more than {_DEEPEST} levels deep"
_MOST_DIGITS: Final = 1_000


@dataclass
class _Open:
    """A list or mapping that has begun: its anchor, how many values it has so far, and how many parts."""

    anchor: str | None
    is_mapping: bool
    values: int = 1
    parts: int = 0


class _TooDeep(MarkedYAMLError):
    """Brackets in brackets; `problem_mark` is the first of them that is too many."""


class _ShallowScanner(Scanner):
    """Refuses brackets as it comes to them: it reads a thousand ahead before anybody sees the first."""

    def fetch_flow_collection_start(self, TokenClass: Any, to_push: str) -> None:
        if len(self.flow_context) >= _DEEPEST:
            raise _TooDeep(problem=_TOO_DEEP, problem_mark=self.reader.get_mark())
        super().fetch_flow_collection_start(TokenClass, to_push)


def require_bounded(text: str, source: str) -> None:
    """Raise MatrixError, with line and column, for a file that is too large, too deep, or more than plain data.

    Aliases may repeat values, but count as what they repeat; tags and lists as keys are refused. Raises
    ruamel's YAMLError for what is no YAML.
    """
    if len(text) > MOST_CHARACTERS:
        raise MatrixError(f"{source}: longer than {MOST_CHARACTERS:,} characters, which no matrix is")
    try:
        found = next(((event.start_mark, message) for event, message in _problems(text)), None)
    except _TooDeep as error:
        found = error.problem_mark, _TOO_DEEP
    if found is not None:
        mark, message = found
        raise MatrixError(f"{source}:{mark.line + 1}:{mark.column + 1}: {message}")


def _problems(text: str) -> Iterator[tuple[Any, str]]:
    """What is wrong, with the event at which it shows."""
    sizes: dict[str, int] = {}
    path = [_Open(None, False)]
    yaml = YAML(typ="safe", pure=True)
    yaml.Scanner = _ShallowScanner
    for event in yaml.parse(text):
        if isinstance(event, CollectionEndEvent):
            done = path.pop()
            path[-1].values += done.values
            if done.anchor is not None:
                sizes[done.anchor] = done.values
        if not isinstance(event, NodeEvent):
            continue
        if (problem := _problem(event, path)) is not None:
            yield event, problem
        path[-1].parts += 1
        if isinstance(event, CollectionStartEvent):
            path.append(_Open(event.anchor, isinstance(event, MappingStartEvent)))
        elif isinstance(event, AliasEvent):
            path[-1].values += sizes.get(event.anchor, 1)
        else:
            path[-1].values += 1
            if event.anchor is not None:
                sizes[event.anchor] = 1
        values = sum(part.values for part in path)
        if values > _MOST_VALUES:
            yield event, f"more than {_MOST_VALUES:,} values up to here, counting what aliases repeat"


def _problem(event: Event, path: list[_Open]) -> str | None:
    """What is wrong with a value at the place that the path leads to."""
    if (tag := getattr(event, "tag", None)) is not None:
        return f"tag {tag!r}: a matrix has plain values only; leave the tag out"
    if isinstance(event, AliasEvent) and any(part.anchor == event.anchor for part in path):
        return f"*{event.anchor} stands inside what it stands for, which never ends"
    if isinstance(event, ScalarEvent) and len(event.value) > _MOST_DIGITS and not event.value.strip("+-0123456789_"):
        return f"a number of {len(event.value):,} digits"
    if not isinstance(event, CollectionStartEvent):
        return None
    if len(path) > _DEEPEST:
        return _TOO_DEEP
    if path[-1].is_mapping and path[-1].parts % 2 == 0:
        return "a list or mapping cannot be a key"
    return None
