"""Codec settings as text, `quality=10 subsampling=444`, and other valid settings of a codec."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from typing import Any

from pydantic import ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from codecbench.core.contracts.errors import ParamsError
from codecbench.core.contracts.params import Params


def setting_from_text(text: str) -> dict[str, Any]:
    """Parse parameters from `KEY=VALUE ...`, with YAML values and shell quotes.

    Raises ParamsError for a word that is not KEY=VALUE, a repeated key or a value that is not YAML.
    """

    try:
        words = shlex.split(text)
    except ValueError as error:
        raise ParamsError(f"{text!r}: {error}") from error
    values: dict[str, Any] = {}
    for word in words:
        key, equals, value = word.partition("=")
        if not equals or not key:
            raise ParamsError(f"{text!r}: {word!r} is not KEY=VALUE")
        if key in values:
            raise ParamsError(f"{text!r}: {key} is given twice")
        try:
            values[key] = YAML(typ="safe").load(value)
        except YAMLError as error:
            raise ParamsError(f"{text!r}: {value!r} is not a YAML value") from error
    return values


def setting_label(name: str, setting: dict[str, Any]) -> str:
    """Return a codec setting's name for reports: `jpeg quality=5 progressive=True`."""
    return " ".join([name, *(f"{key}={value}" for key, value in setting.items())])


def other_settings(params: Params, limit: int = 4) -> list[Params]:
    """Return up to `limit` valid settings other than `params`: the defaults, then one field changed at a time.

    The list is empty only for codecs without parameters.
    """
    kind = type(params)
    values = params.model_dump(mode="json")
    candidates = [{}, *({**values, name: value} for name, value in _replacements(kind, values))]
    settings: list[Params] = []
    for candidate in candidates:
        try:
            other = kind.model_validate(candidate)
        except ValidationError:
            continue
        if other != params and other not in settings:
            settings.append(other)
    return settings[:limit]


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
