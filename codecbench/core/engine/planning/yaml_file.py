"""YAML 1.2 with positions: where in the file each value stands, and a list of everything wrong with it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from typing import Any, Final

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.error import MarkedYAMLError, YAMLError

from codecbench.core.contracts.errors import MatrixError
from codecbench.core.engine.planning.yaml_bounds import MOST_CHARACTERS, require_bounded

Where = tuple[str | int, ...]
"""The way from the top of a file to a value: `("codecs", 1, "params", "qf")`."""


_SHOWN: Final = 80
"""Characters of a value that a message repeats."""
_MOST_TOLD: Final = 50
"""Problems that are spelled out; an axis may have thousands of wrong values."""


@dataclass
class Problems:
    """Collects what is wrong with one file, so that all of it is reported at once."""

    source: str
    root: Any = None
    found: list[tuple[int, int, str]] = field(default_factory=list)

    def add(self, where: Where, message: str, *, at_key: bool = False) -> None:
        """Note a problem with the value at `where`, or with its key."""
        line, column = position(self.root, where, at_key=at_key)
        self.found.append((line, column, f"{spell(where)}: {message}" if where else message))

    def unknown(self, where: Where, given: Iterable[Any], allowed: Iterable[str]) -> None:
        """Note every key of a mapping that is not allowed, with what may have been meant."""
        names = list(allowed)
        for key in given:
            if key not in names:
                self.add((*where, key), f"unknown; {suggest(str(key), names)}", at_key=True)

    def raise_any(self) -> None:
        """Raise MatrixError with the problems, in the order of the file, if there is one."""
        if self.found:
            found = sorted(set(self.found))
            lines = [f"{self.source}:{line}:{column}: {message}" for line, column, message in found[:_MOST_TOLD]]
            if len(found) > _MOST_TOLD:
                lines.append(f"and {len(found) - _MOST_TOLD} more")
            raise MatrixError("\n".join(lines))


def load(path: Path) -> tuple[str, Any]:
    """The text of a YAML file and its content, which remembers positions. Raises MatrixError."""
    try:
        if path.exists() and not path.is_file():
            raise MatrixError(f"{path}: not a plain file; a matrix is a text file of YAML")  # a pipe would never end
        with path.open(encoding="utf-8") as file:
            text = file.read(MOST_CHARACTERS + 1)
    except FileNotFoundError:
        raise MatrixError(f"{path}: no such file; codecbench's folder examples/ has matrices to begin with") from None
    except (OSError, UnicodeDecodeError) as error:
        raise MatrixError(f"{path}: cannot be read as UTF-8 text: {error}") from None
    return text, parsed(text, str(path))


def parsed(text: str, source: str) -> Any:
    """The content of a YAML text, which remembers positions. source: what errors call it. Raises MatrixError."""
    try:
        require_bounded(text, source)
        return YAML(typ="rt").load(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f":{mark.line + 1}:{mark.column + 1}" if mark else ""
        raise MatrixError(f"{source}{where}: not valid YAML: {error.problem or error.context}") from None
    except (YAMLError, ValueError, OverflowError) as error:
        raise MatrixError(f"{source}: not valid YAML: {error}") from None


def written(root: Any) -> str:
    """The YAML text of a content that `parsed` gave and that was changed, with its comments."""
    stream, writer = StringIO(), YAML(typ="rt")
    writer.width = MOST_CHARACTERS  # lines are not broken
    writer.dump(root, stream)
    return stream.getvalue()


def plain(value: Any) -> Any:
    """The value as ordinary dicts, lists and scalars."""
    if isinstance(value, Mapping):
        return {plain(key): plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [plain(item) for item in value]
    for kind in (bool, int, float, str):
        if isinstance(value, kind):
            return kind(value)
    return value


def shown(value: Any) -> str:
    """The value as messages spell it: as Python does, and not at length."""
    text = repr(plain(value))
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


def position(root: Any, where: Where, *, at_key: bool = False) -> tuple[int, int]:
    """Line and column, from 1, of the value at `where`, or of the nearest thing above it that is in the file."""
    found = (1, 1)
    node = root
    for depth, step in enumerate(where):
        last = depth == len(where) - 1
        if isinstance(node, CommentedMap) and step in node:
            line, column = node.lc.key(step) if last and at_key else node.lc.value(step)
        elif isinstance(node, CommentedSeq) and isinstance(step, int) and step < len(node):
            line, column = node.lc.item(step)
        else:
            break
        found = (line + 1, column + 1)
        node = node[step]
    return found


def spell(where: Where) -> str:
    """`codecs[1].params.qf`."""
    text = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in where)
    return text.removeprefix(".")


def suggest(name: str, allowed: list[str]) -> str:
    """`did you mean 'codecs'? allowed: ...`"""
    import difflib

    near = difflib.get_close_matches(name, allowed, n=1)
    meant = f"did you mean {near[0]!r}? " if near else ""
    return f"{meant}allowed: {', '.join(allowed)}"
