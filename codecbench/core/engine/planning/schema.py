"""JSON Schema of matrices and of plugin parameters, for editors and for people."""

from __future__ import annotations

import difflib
from typing import Any, Final

from codecbench.core.contracts.errors import PluginError, Unsupported
from codecbench.core.contracts.hooks import KINDS, Kind
from codecbench.core.engine.planning.matrix import RunSection
from codecbench.core.engine.planning.search_section import PASSES, SearchSection
from codecbench.core.engine.plugins.plugin import Plugin
from codecbench.core.engine.plugins.registry import Registry

_AT: Final = {
    "type": "object",
    "minProperties": 1,
    "maxProperties": 1,
    "additionalProperties": {"type": "number"},
    "description": "a metric and the value at which all such entries are compared",
}


def plugin_schema(registry: Registry, name: str) -> dict[str, Any]:
    """Return the schema of one plugin's parameters. name: NAME or KIND:NAME. Raises PluginError if it is unknown."""
    kind_name, _, bare = name.rpartition(":")
    kinds = [kind for kind in KINDS if kind_name in ("", kind)]
    matches = [plugin for kind in kinds for plugin in registry.plugins(kind) if plugin.spec.name == bare]
    if len(matches) == 1:
        schema: dict[str, Any] = _params_schema(registry, matches[0])
        return schema
    if matches:
        choices = ", ".join(f"{plugin.kind}:{bare}" for plugin in matches)
        raise PluginError(f"several plugins are called {bare!r}; say which: {choices}")
    names = [plugin.spec.name for kind in kinds for plugin in registry.plugins(kind)]
    nearest = difflib.get_close_matches(bare, names, n=1)
    hint = f"did you mean {nearest[0]!r}?" if nearest else "see codecbench list"
    raise PluginError(f"no plugin is called {name!r}; {hint}")


def matrix_schema(registry: Registry) -> dict[str, Any]:
    """Return the schema of a whole matrix with everything that is installed."""
    sections: dict[str, Kind] = {"sequences": "dataset", "codecs": "codec", "evaluators": "evaluator"}
    definitions: dict[str, Any] = {}
    properties: dict[str, Any] = {
        "version": {"const": 1},
        "name": {"type": "string", "pattern": "^[A-Za-z0-9][A-Za-z0-9._-]*$"},
    }
    for section, kind in sections.items():
        items = {"anyOf": _choices(registry, kind, definitions)}
        properties[section] = {"type": "array", "minItems": 1, "items": items}
    run = RunSection.model_json_schema()
    definitions.update(run.pop("$defs", {}))
    decided = definitions["UntilSection"]["properties"]["decided"]
    definitions["UntilSection"]["properties"]["decided"] = {"anyOf": [{"type": "string"}, decided]}
    run["properties"]["executor"] = {"anyOf": _choices(registry, "executor", definitions)}
    properties["run"] = run
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "codecbench matrix",
        "type": "object",
        "additionalProperties": False,
        "required": ["version", *sections],
        "properties": properties,
        "$defs": definitions,
    }


def _choices(registry: Registry, kind: Kind, definitions: dict[str, Any]) -> list[Any]:
    choices: list[Any] = [{"enum": [plugin.spec.name for plugin in registry.plugins(kind)]}]
    for plugin in registry.plugins(kind):
        try:
            params = _params_schema(registry, plugin)
        except (Unsupported, PluginError):
            params = {"type": "object"}
        definitions.update(params.pop("$defs", {}))
        for name, value in params.get("properties", {}).items():
            params["properties"][name] = _or_axis(value)
        properties = {"use": {"const": plugin.spec.name}, "params": params}
        if kind == "dataset":
            properties["name"] = {"type": "string"}
        if kind == "codec":
            properties |= {"search": {"anyOf": [SearchSection.model_json_schema(), {"const": PASSES}]}, "at": _AT}
        required = ["use", "params"] if params.get("required") else ["use"]
        choices.append(
            {
                "type": "object",
                "description": plugin.spec.summary,
                "properties": properties,
                "required": required,
                "additionalProperties": False,
            }
        )
    return choices


def _params_schema(registry: Registry, plugin: Plugin) -> dict[str, Any]:
    plugin_key = plugin.kind, plugin.spec.name
    schema: dict[str, Any] = registry.ask(params_schema, *plugin_key, of=[plugin_key])
    return schema


def params_schema(registry: Registry, kind: Kind, name: str) -> dict[str, Any]:
    """Return the JSON Schema of a plugin's parameters."""
    schema: dict[str, Any] = registry.load(kind, name).params_type.model_json_schema()
    return schema


def _or_axis(value: Any) -> dict[str, Any]:
    """Return the schema of a value or of an axis of such values."""
    annotations = {key: value.pop(key) for key in ("title", "description", "default") if key in value}
    grid = {"type": "array", "minItems": 1, "items": value}
    steps = {"type": "array", "minItems": 2, "maxItems": 3, "items": {"type": "number"}}
    axes = [
        {"type": "object", "properties": {word: choices}, "required": [word], "additionalProperties": False}
        for word, choices in (("grid", grid), ("range", steps))
    ]
    return {**annotations, "anyOf": [value, *axes]}
