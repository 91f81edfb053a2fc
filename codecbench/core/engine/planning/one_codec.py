"""A codec by its name, for scripts and notebooks."""

from __future__ import annotations

from typing import Any

from codecbench.core.contracts.codec import AnyCodec
from codecbench.core.contracts.errors import ParamsError
from codecbench.core.engine.planning.description import InvalidParams, describe
from codecbench.core.engine.plugins.registry import installed


def codec(name: str, **params: Any) -> AnyCodec[Any]:
    """One setting of an installed codec, by its name in a matrix and its parameters.

    Raises PluginError, with the nearest name, for an unknown one, ParamsError for parameters that it does not take, and
    Unsupported, with the command that mends it, where a library is missing.
    """
    registry = installed()
    try:
        describe(registry, "codec", name, params)
    except InvalidParams as invalid:
        several = [key for key, value in params.items() if isinstance(value, list | tuple | range)]
        one = f"; one value is wanted of {', '.join(several)}: make a codec of each, or a grid in a matrix"
        raise ParamsError(f"codec {name}: {invalid.sentence}{one if several else ''}") from None
    found: AnyCodec[Any] = registry.create("codec", name, params)
    return found
