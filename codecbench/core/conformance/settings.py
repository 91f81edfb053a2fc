"""A codec setting as people write it: `quality=10 subsampling=444`."""

from __future__ import annotations

import shlex
from typing import Any

from codecbench.core.contracts.errors import ParamsError


def setting_from_text(text: str) -> dict[str, Any]:
    """Parameters from `KEY=VALUE ...`, with values as YAML has them and quotes as a shell has them.

    Raises ParamsError for a word that is not KEY=VALUE, a repeated key or a value that is not YAML.
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

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
    """A codec setting's name in a report: `jpeg quality=5 progressive=True`."""
    return " ".join([name, *(f"{key}={value}" for key, value in setting.items())])
