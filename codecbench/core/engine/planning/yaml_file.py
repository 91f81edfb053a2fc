"""Read YAML 1.2 safely, with the position of each value and a list of everything wrong with the file."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from typing import Any, Final

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.error import MarkedYAMLError, YAMLError
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
"""Including what aliases repeat: `*name` counts as much as what it stands for."""
_DEEPEST: Final = 64
_TOO_DEEP: Final = f"more than {_DEEPEST} levels deep"
_MOST_DIGITS: Final = 1_000


@dataclass
class _Open:
    """A list or mapping being parsed."""

    anchor: str | None
    is_mapping: bool
    values: int = 1
    """Number of values so far, including nested ones."""
    parts: int = 0
    """Number of direct children so far."""


class _TooDeep(MarkedYAMLError):
    """Raised for brackets nested too deeply; `problem_mark` is the first one too many."""


class _ShallowScanner(Scanner):
    """Rejects deeply nested brackets while scanning, because the scanner reads a thousand ahead."""

    def fetch_flow_collection_start(self, TokenClass: Any, to_push: str) -> None:
        if len(self.flow_context) >= _DEEPEST:
            raise _TooDeep(problem=_TOO_DEEP, problem_mark=self.reader.get_mark())
        super().fetch_flow_collection_start(TokenClass, to_push)


def require_bounded(text: str, source: str) -> None:
    """Raise MatrixError, with line and column, if a file is too large, too deep, or more than plain data.

    Works on the grammar alone, before anything is built. Aliases count as what they repeat; tags and lists as keys are
    rejected. Raises ruamel's YAMLError if the text is not YAML.
    """
    if len(text) > MOST_CHARACTERS:
        raise MatrixError(f"{source}: longer than {MOST_CHARACTERS:,} characters, the limit of a matrix")
    try:
        problem = next(((event.start_mark, message) for event, message in _problems(text)), None)
    except _TooDeep as error:
        problem = error.problem_mark, _TOO_DEEP
    if problem is not None:
        mark, message = problem
        raise MatrixError(f"{source}:{mark.line + 1}:{mark.column + 1}: {message}")


def _problems(text: str) -> Iterator[tuple[Any, str]]:
    """Yield each problem with the event at which it shows."""
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
            yield event, f"more than {_MOST_VALUES:,} values up to here, including those that aliases repeat"


def _problem(event: Event, path: list[_Open]) -> str | None:
    """Return what is wrong with a value at the place that the path leads to, or None."""
    if (tag := getattr(event, "tag", None)) is not None:
        return f"tag {tag!r}: a matrix has plain values only; leave the tag out"
    if isinstance(event, AliasEvent) and any(part.anchor == event.anchor for part in path):
        return f"*{event.anchor} refers to a value that contains it"
    if isinstance(event, ScalarEvent) and len(event.value) > _MOST_DIGITS and not event.value.strip("+-0123456789_"):
        return f"a number of {len(event.value):,} digits"
    if not isinstance(event, CollectionStartEvent):
        return None
    if len(path) > _DEEPEST:
        return _TOO_DEEP
    if path[-1].is_mapping and path[-1].parts % 2 == 0:
        return "a list or mapping cannot be a key"
    return None


Where = tuple[str | int, ...]
"""Path from the top of a file to a value: `("codecs", 1, "params", "qf")`."""


_SHOWN: Final = 80
"""Maximum number of characters of a value in a message."""
_MOST_TOLD: Final = 50
"""Maximum number of problems that are listed; an axis may have thousands of wrong values."""


@dataclass
class Problems:
    """Collects everything that is wrong with one file, to report all of it at once."""

    source: str
    root: Any = None
    entries: list[tuple[int, int, str]] = field(default_factory=list)

    def add(self, where: Where, message: str, *, at_key: bool = False) -> None:
        """Note a problem with the value at `where`, or with its key."""
        line, column = position(self.root, where, at_key=at_key)
        self.entries.append((line, column, f"{format_path(where)}: {message}" if where else message))

    def unknown(self, where: Where, given: Iterable[Any], allowed: Iterable[str]) -> None:
        """Note every key of a mapping that is not allowed, with the nearest allowed one."""
        names = list(allowed)
        for key in given:
            if key not in names:
                self.add((*where, key), f"unknown; {suggest(str(key), names)}", at_key=True)

    def raise_any(self) -> None:
        """Raise MatrixError with all problems in file order, if there are any."""
        if self.entries:
            entries = sorted(set(self.entries))
            lines = [f"{self.source}:{line}:{column}: {message}" for line, column, message in entries[:_MOST_TOLD]]
            if len(entries) > _MOST_TOLD:
                lines.append(f"and {len(entries) - _MOST_TOLD} more")
            raise MatrixError("\n".join(lines))


def load_yaml(path: Path) -> tuple[str, Any]:
    """Return the text of a YAML file and its content with positions. Raises MatrixError."""
    try:
        if path.exists() and not path.is_file():
            raise MatrixError(f"{path}: not a plain file; a matrix is a YAML text file")  # a pipe might never end
        with path.open(encoding="utf-8") as file:
            text = file.read(MOST_CHARACTERS + 1)
    except FileNotFoundError:
        raise MatrixError(f"{path}: no such file; codecbench's folder examples/ has matrices to begin with") from None
    except (OSError, UnicodeDecodeError) as error:
        raise MatrixError(f"{path}: cannot be read as UTF-8 text: {error}") from None
    return text, parse_yaml(text, str(path))


def parse_yaml(text: str, source: str) -> Any:
    """Return the content of a YAML text with positions. source: its name in errors. Raises MatrixError."""
    try:
        require_bounded(text, source)
        return YAML(typ="rt").load(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f":{mark.line + 1}:{mark.column + 1}" if mark else ""
        raise MatrixError(f"{source}{where}: not valid YAML: {error.problem or error.context}") from None
    except (YAMLError, ValueError, OverflowError) as error:
        raise MatrixError(f"{source}: not valid YAML: {error}") from None


def yaml_text(root: Any) -> str:
    """Return the YAML text of a modified result of `parse_yaml`, with its comments."""
    stream, writer = StringIO(), YAML(typ="rt")
    writer.width = MOST_CHARACTERS  # do not break lines
    writer.dump(root, stream)
    return stream.getvalue()


def plain_value(value: Any) -> Any:
    """Convert a value to ordinary dicts, lists and scalars."""
    if isinstance(value, Mapping):
        return {plain_value(key): plain_value(item) for key, item in value.items()}
    if isinstance(value, list):
        return [plain_value(item) for item in value]
    for kind in (bool, int, float, str):
        if isinstance(value, kind):
            return kind(value)
    return value


def format_value(value: Any) -> str:
    """Format a value for messages: Python's repr, truncated."""
    text = repr(plain_value(value))
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


def position(root: Any, where: Where, *, at_key: bool = False) -> tuple[int, int]:
    """Return line and column, from 1, of the value at `where`, or of its nearest ancestor in the file."""
    result = (1, 1)
    node = root
    for depth, step in enumerate(where):
        last = depth == len(where) - 1
        if isinstance(node, CommentedMap) and step in node:
            line, column = node.lc.key(step) if last and at_key else node.lc.value(step)
        elif isinstance(node, CommentedSeq) and isinstance(step, int) and step < len(node):
            line, column = node.lc.item(step)
        else:
            break
        result = (line + 1, column + 1)
        node = node[step]
    return result


def format_path(where: Where) -> str:
    """Format a path as `codecs[1].params.qf`."""
    text = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in where)
    return text.removeprefix(".")


def suggest(name: str, allowed: list[str]) -> str:
    """Format a hint: `did you mean 'codecs'? allowed: ...`"""
    nearest = difflib.get_close_matches(name, allowed, n=1)
    hint = f"did you mean {nearest[0]!r}? " if nearest else ""
    return f"{hint}allowed: {', '.join(allowed)}"
