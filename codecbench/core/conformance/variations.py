"""Other valid settings of a codec, found from the schema of its parameters."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from pydantic import ValidationError

from codecbench.core.contracts.params import Params


def other_settings(params: Params, limit: int = 4) -> list[Params]:
    """Up to `limit` valid settings that differ from `params`: the defaults first, then one field changed at a time.

    Empty only for codecs with nothing to set.
    """
    kind = type(params)
    values = params.model_dump(mode="json")
    candidates = [{}, *({**values, name: value} for name, value in _replacements(kind, values))]
    found: list[Params] = []
    for candidate in candidates:
        try:
            other = kind.model_validate(candidate)
        except ValidationError:
            continue
        if other != params and other not in found:
            found.append(other)
    return found[:limit]


def _replacements(kind: type[Params], values: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    properties = kind.model_json_schema().get("properties", {})
    for name, schema in properties.items():
        for option in [schema, *schema.get("anyOf", [])]:
            for value in _values(option, values.get(name)):
                yield name, value


def _values(schema: dict[str, Any], current: Any) -> list[Any]:
    if "enum" in schema:
        return [value for value in schema["enum"] if value != current]
    kind = schema.get("type")
    if kind == "boolean":
        return [not current]
    if kind in ("integer", "number"):
        start = current if isinstance(current, int | float) and not isinstance(current, bool) else 1
        return [start * 3, start + 1, max(start - 1, schema.get("minimum", 0)), start / 2 if kind == "number" else 1]
    return [None] if kind == "null" else []
