"""Read the matrix file, which crosses sequences, codecs and evaluators, and validate all of it before anything runs."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from codecbench.core.contracts.errors import CodecbenchError, MatrixError, Unsupported
from codecbench.core.contracts.hooks import Kind
from codecbench.core.engine.planning.axes import Point, axes, axis_hint, points
from codecbench.core.engine.planning.description import InvalidParams, describe, error_text
from codecbench.core.engine.planning.entry import Entry, label_entries, unique_entries
from codecbench.core.engine.planning.model import PluginSetting, RunSettings
from codecbench.core.engine.planning.objective import Objective, UntilSection, find_decided_objective, require_sources
from codecbench.core.engine.planning.search import Search, find_searches
from codecbench.core.engine.planning.search_section import read_search_spec
from codecbench.core.engine.planning.yaml_file import (
    Problems,
    Where,
    format_value,
    load_yaml,
    parse_yaml,
    plain_value,
    suggest,
)
from codecbench.core.engine.plugins.registry import Registry, installed

VERSION = 1
_SECTIONS: dict[str, Kind] = {"sequences": "dataset", "codecs": "codec", "evaluators": "evaluator"}
_TOP = ("version", "name", *_SECTIONS, "anchors", "run")
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")


class RunSection(BaseModel):
    """The `run:` section: how the matrix is run. Only `seed` can change a result."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    workers: int = Field(default_factory=lambda: os.cpu_count() or 1, ge=1, le=100_000)
    timeout_s: float = Field(default=3600.0, gt=0, description="for one coding job or cell")
    memory_mb: int = Field(default=4096, ge=256, description="for one coding job or cell")
    seed: int = Field(default=0, ge=0, lt=1 << 63)
    until: UntilSection | None = Field(default=None, description="repeats are added until this is decided")


@dataclass(frozen=True)
class Matrix:
    """A matrix file with every name and parameter checked."""

    path: Path
    text: str
    name: str
    sequences: tuple[Entry, ...]
    codecs: tuple[Entry, ...]
    """Entries of the file, and all settings that the searches may try."""
    evaluators: tuple[Entry, ...]
    run: RunSettings
    root: Any
    searches: tuple[Search, ...] = ()
    until: Objective | None = None
    """What is to be decided by adding repeats."""
    anchors: tuple[str, ...] | None = None
    """Codecs that rates are compared with; None for those that declare themselves anchors."""

    def problems(self) -> Problems:
        """Return an empty list of problems of this file, for checks that need more than the file."""
        return Problems(str(self.path), self.root)


def read_matrix(path: str | Path, registry: Registry | None = None) -> Matrix:
    """Read and check a matrix file.

    Raises MatrixError that lists every problem as `file:line:column: place: what, allowed, suggestion`.
    """
    path = Path(path)
    text, root = load_yaml(path)
    return _check_matrix(path, text, root, path.resolve().parent, registry)


def matrix_from(
    content: str | Mapping[str, Any], registry: Registry | None = None, folder: Path | None = None
) -> Matrix:
    """Check a matrix that is not a file: YAML text, or a mapping of JSON types and paths.

    folder: base of relative paths, by default the working directory. Raises MatrixError as `read_matrix` does, with
    lines of the text, or of the mapping as JSON.
    """
    try:
        text = content if isinstance(content, str) else json.dumps(content, indent=2, default=os.fspath)
    except TypeError as error:
        raise MatrixError(f"matrix: {error}; a matrix has mappings, lists, strings, numbers and paths") from None
    return _check_matrix(Path("matrix"), text, parse_yaml(text, "matrix"), folder or Path.cwd(), registry)


def _check_matrix(path: Path, text: str, root: Any, folder: Path, registry: Registry | None) -> Matrix:
    """Check the matrix of a parsed text. folder: base of relative paths."""
    problems = Problems(str(path), root)
    reader = _Reader(problems, registry or installed(), folder)
    if not isinstance(root, Mapping):
        problems.add((), f"a matrix is a mapping with {', '.join(_TOP)}; got {type(plain_value(root)).__name__}")
        problems.raise_any()
    problems.unknown((), root, _TOP)
    if root.get("version") != VERSION:
        problems.add(("version",), f"must be {VERSION}; got {plain_value(root.get('version'))!r}")
    name = plain_value(root.get("name", path.stem))
    if not (isinstance(name, str) and _NAME.fullmatch(name)):
        problems.add(("name",), f"{format_value(name)} may have only letters, digits, '.', '_' and '-'")
    sections = {section: reader.section(section, root.get(section)) for section in _SECTIONS}
    run = reader.run_section(root.get("run") or {})
    anchors = _anchors(root.get("anchors"), sections["codecs"], problems)
    problems.raise_any()
    assert run is not None
    searches = find_searches(sections["codecs"], sections["evaluators"], problems)
    until = find_decided_objective(run[1], root, sections["evaluators"], problems)
    require_sources(sections["evaluators"], reader.registry, problems)
    problems.raise_any()
    require_plannable(sections, searches, problems)
    named: Any = {**sections, "searches": searches, "until": until, "anchors": anchors}
    return Matrix(path=path, text=text, name=name, run=run[0], root=root, **named)


class _Reader:
    """Reads sections; notes every problem and continues."""

    def __init__(self, problems: Problems, registry: Registry, folder: Path) -> None:
        self.problems = problems
        self.registry = registry
        self.folder = folder

    def section(self, section: str, items: Any) -> tuple[Entry, ...]:
        kind = _SECTIONS[section]
        if not isinstance(items, list) or not items:
            got = "nothing" if items is None else format_value(items)
            self.problems.add((section,), f"must be a list with at least one {kind}; got {got}")
            return ()
        entries: list[Entry] = []
        for index, item in enumerate(items):
            entries.extend(self.entries(kind, (section, index), item))
        return label_entries(unique_entries(entries))

    def entries(self, kind: Kind, where: Where, item: Any) -> Iterator[Entry]:
        """Yield the settings that one item of a section spans."""
        if isinstance(item, str):
            item = {"use": item}
        if not isinstance(item, Mapping) or not isinstance(item.get("use"), str):
            self.problems.add(where, f"must be a name or a mapping with `use: NAME`; got {format_value(item)}")
            return
        more = {"dataset": ("name",), "codec": ("search", "at")}.get(kind, ())
        self.problems.unknown(where, item, ("use", *more, "params"))
        name = plain_value(item.get("name"))
        if name is not None and not (isinstance(name, str) and _NAME.fullmatch(name)):
            self.problems.add((*where, "name"), f"{format_value(name)} may have only letters, digits, '.', '_' and '-'")
            return
        params = item.get("params") or {}
        if not isinstance(params, Mapping):
            self.problems.add((*where, "params"), f"must be a mapping; got {format_value(params)}")
            return
        spanned, search = axes(params, (*where, "params"), self.problems), None
        if kind == "codec" and ("search" in item or "at" in item):
            search = read_search_spec(item, where, spanned, self.problems)
        for point in points(spanned):
            entry = self.entry(kind, where, str(item["use"]), point)
            if entry is not None:
                yield replace(entry, name=name, search=search)

    def entry(self, kind: Kind, where: Where, name: str, point: Point) -> Entry | None:
        """Return one validated setting, or None after noting what is wrong with it."""
        values = {key: value for key, (_, value) in point.items()}
        written = frozenset(values)
        unusable, plugin = Entry(where, PluginSetting(kind, name, "", values), written), None
        if (broken := self.registry.maybe_broken(kind, name)) is not None:
            return replace(unusable, missing=broken, faulty=True)
        try:
            plugin = self.registry.find(kind, name)
            description = describe(self.registry, kind, name, values, str(self.folder))
        except InvalidParams as invalid:
            if plugin is not None and plugin.hosted and (fault := _default_fault(invalid, values)):
                return replace(unusable, missing=f"{plugin.title}: {fault}", faulty=True)
            for detail in invalid.details:
                self.note(where, point, detail, invalid.fields)
            return None
        except Unsupported as error:
            return replace(unusable, missing=str(error))
        except CodecbenchError as error:
            if plugin is not None and plugin.hosted:
                named = plugin.title in str(error)
                return replace(unusable, missing=str(error) if named else f"{plugin.title}: {error}", faulty=True)
            self.problems.add((*where, "use"), str(error))
            return None
        setting = description.setting(kind, name, plugin.foreign)
        return Entry(where, setting, written, description=description)

    def note(self, where: Where, point: Point, detail: Any, fields: list[str]) -> None:
        """Turn one of pydantic's errors into a problem at the value that it is about."""
        location = detail["loc"]
        if not location:
            self.problems.add((*where, "params"), error_text(detail))
        elif detail["type"] == "extra_forbidden" and len(location) == 1:
            self.problems.add((*where, "params", location[0]), f"unknown; {suggest(location[0], fields)}", at_key=True)
        elif detail["type"] == "missing":
            self.problems.add((*where, "params", *location), "required")
        else:
            place, value = point.get(location[0], ((*where, "params"), None))
            hint = "" if any(isinstance(part, int) for part in location) else axis_hint(str(location[0]), value)
            self.problems.add((*place, *location[1:]), error_text(detail) + hint)

    def run_section(self, section: Any) -> tuple[RunSettings, UntilSection | None] | None:
        if not isinstance(section, Mapping):
            self.problems.add(("run",), f"must be a mapping; got {format_value(section)}")
            return None
        values = plain_value(section)
        default = next((plugin.spec.name for plugin in self.registry.plugins("executor")), None)
        executor = list(self.entries("executor", ("run", "executor"), section.get("executor", default)))
        values.pop("executor", None)
        try:
            run = RunSection.model_validate(values)
        except ValidationError as error:
            fields = [*RunSection.model_fields, "executor"]
            for detail in error.errors():
                key = detail["loc"][0]
                unknown = detail["type"] == "extra_forbidden"
                message = f"unknown; {suggest(str(key), fields)}" if unknown else error_text(detail)
                self.problems.add(("run", *detail["loc"]), message, at_key=unknown)
            return None
        if len(executor) != 1:
            if executor:
                self.problems.add(("run", "executor"), "must be one setting, without axes")
            return None
        if executor[0].missing:
            self.problems.add(("run", "executor"), executor[0].missing)
            return None
        return RunSettings(run.workers, run.timeout_s, run.memory_mb, run.seed, executor[0].setting), run.until


def _anchors(items: Any, codecs: tuple[Entry, ...], problems: Problems) -> tuple[str, ...] | None:
    """Return the codecs to compare rates with, each in the matrix and no baseline; None if the file names none."""
    if items is None:
        return None
    if not isinstance(items, list) or not items:
        problems.add(("anchors",), f"must be a list of codecs; got {format_value(items)}")
        return None
    names = [str(plain_value(item)) for item in items]
    references = {entry.setting.name: entry.description and entry.description.declared for entry in codecs}
    for place, name in enumerate(names):
        if name not in references:
            problems.add(("anchors", place), f"{name!r} is no codec of this matrix; {suggest(name, list(references))}")
        elif (references[name] or {}).get("reference") == "baseline":
            problems.add(("anchors", place), f"{name} is the baseline, which has no curve to compare with")
    return tuple(names)


def _default_fault(invalid: InvalidParams, values: Mapping[str, Any]) -> str | None:
    """Describe a default value that its own plugin rejects, or return None."""
    for detail in invalid.details:
        name = detail["loc"][0] if detail["loc"] else None
        if detail["type"] != "missing" and name not in values and (name is not None or not values):
            return f"parameter {name}: {error_text(detail)}" if name else error_text(detail)
    return None


_MOST_CELLS: Final = 1_000_000


def require_plannable(
    sections: Mapping[str, tuple[Entry, ...]], searches: tuple[Search, ...], problems: Problems
) -> None:
    """Raise MatrixError if crossing the sections gives more cells than can be planned."""
    counts = {section: len(entries) for section, entries in sections.items()}
    counts["codecs"] = sum(entry.search is None for entry in sections["codecs"])
    counts["codecs"] += sum(min(search.budget, len(search.settings)) for search in searches)
    cells = math.prod(counts.values())
    if cells > _MOST_CELLS:
        spelled = " x ".join(f"{count:,} {section}" for section, count in counts.items())
        problems.add((), f"{spelled} = {cells:,} cells; at most {_MOST_CELLS:,} are allowed")
        problems.raise_any()
