"""From a plugin's specification to its class, which must keep the contract of its kind."""

from __future__ import annotations

import difflib
import importlib
import inspect
from typing import Any, Final

from codecbench.core.contracts.errors import PluginError, Unsupported
from codecbench.core.contracts.hooks import Kind, PluginSpec
from codecbench.core.engine.text import describe_error

_BASES: Final[dict[Kind, tuple[str, ...]]] = {
    "codec": ("codec:Codec", "codec:StreamCodec", "codec:FeatureCodec"),
    "evaluator": ("evaluator:Evaluator",),
    "dataset": ("sequence:Dataset",),
    "slam_backend": ("slam:SlamBackend",),
    "executor": ("executor:Executor",),
    "link": ("link:Link",),
}
"""In codecbench.core.contracts; a plugin subclasses one of those of its kind."""


def load_class(kind: Kind, spec: PluginSpec, title: str) -> Any:
    """The class of a plugin, imported into this process now. title: how messages name the plugin.

    Raises PluginError where its module fails to import or it breaks the contract, and Unsupported where it says so.
    """
    module_name, _, class_name = spec.target.partition(":")
    try:
        module = importlib.import_module(module_name)
    except Unsupported:
        raise
    except Exception as error:
        raise PluginError(f"{title}: {module_name} does not import: {describe_error(error)}") from error
    cls: Any = getattr(module, class_name, None)
    if not hasattr(module, class_name):
        near = difflib.get_close_matches(class_name, vars(module), n=1)
        meant = f"; did you mean {near[0]}?" if near else ""
        raise PluginError(f"{title}: {module_name} has no {class_name}{meant}")
    bases = _bases(kind)
    base = next((base for base in bases if isinstance(cls, type) and issubclass(cls, base)), None)
    if base is None:
        allowed = " or ".join(f"codecbench.{base.__name__}" for base in bases)
        raise PluginError(f"{title}: {spec.target} is not a subclass of {allowed}")
    name = getattr(cls, "name", None)
    if name != spec.name:
        raise PluginError(f"{title}: {spec.target} calls itself {name!r}")
    for attribute in dict.fromkeys(name for ancestor in base.__mro__ for name in inspect.get_annotations(ancestor)):
        if not hasattr(cls, attribute):
            raise PluginError(f"{title}: {spec.target} has no class attribute {attribute!r}")
    if left := sorted(getattr(cls, "__abstractmethods__", ())):
        raise PluginError(f"{title}: {spec.target} does not define {', '.join(left)}")
    return cls


def _bases(kind: Kind) -> list[type]:
    places = (place.split(":") for place in _BASES[kind])
    return [getattr(importlib.import_module(f"codecbench.core.contracts.{module}"), name) for module, name in places]
