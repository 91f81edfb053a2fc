"""Encode values as messages between a host and its caller: JSON, with bytes in shared memory. Never pickle.

Plain values, bytes, arrays, and codecbench's dataclasses and enumerations are copied. Objects stay where they are: the
other side gets a reference, see `channel`. Of anything else only the type's name is sent, which is enough for an error
message.
"""

from __future__ import annotations

import enum
import importlib
import sys
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any, Final, Protocol, TypeAlias

_OURS: Final = "codecbench."
_DEEPEST: Final = 40


Payload: TypeAlias = "list[bytes | memoryview]"
"""The large parts of a message, in order."""


class WireError(Exception):
    """Raised for a message that codecbench never writes."""


class Objects(Protocol):
    """The objects of a conversation."""

    obeys: bool
    """Whether the other side is trusted, so that a message may import a module."""

    def refer(self, value: object) -> dict[str, Any] | None:
        """Return a reference to an object that stays here, `facts` not packed yet; None for a value to be copied."""

    def resolve(self, reference: dict[str, Any]) -> Any:
        """Return the object that a reference stands for. Raises WireError if there is none."""


def pack(value: Any, objects: Objects, payload: Payload) -> Any:
    """Convert a value to JSON types; bytes are appended to `payload`."""
    kind = type(value)
    if value is None or kind in (bool, int, float, str):
        return value
    if (named := objects.refer(value)) is not None:
        if "facts" in named:
            named["facts"] = pack(named["facts"], objects, payload)
        return named
    if issubclass(kind, bytes):
        return {"bytes": _append(payload, memoryview(value).tobytes())}  # a subclass may override everything else
    if issubclass(kind, enum.Enum) and kind.__module__.startswith(_OURS):
        return {"enum": f"{kind.__module__}:{kind.__qualname__}", "name": value.name}
    for plain, spelled in ((bool, bool), (int, int.__int__), (float, float.__float__), (str, str.__str__)):
        if issubclass(kind, plain):
            return spelled(value)  # type: ignore[operator]
    if issubclass(kind, list | tuple) and not hasattr(kind, "_fields"):
        return {"list" if issubclass(kind, list) else "tuple": [pack(item, objects, payload) for item in list(value)]}
    if issubclass(kind, set | frozenset):
        return {"set": [pack(item, objects, payload) for item in set(value)]}
    if issubclass(kind, dict):
        return {"dict": [[pack(part, objects, payload) for part in pair] for pair in dict(value).items()]}
    if (record := _record_type(kind)) is not None:
        parts = {name: pack(getattr(value, name), objects, payload) for name in _names(kind)}
        return {"record": record, "fields": parts}
    array = _pack_array(value, payload)
    return {"other": kind.__name__} if array is None else array


def unpack(value: Any, objects: Objects, memory: memoryview, depth: int = 0) -> Any:
    """Read the value that `pack` wrote; arrays and bytes are copied. Raises WireError for anything else."""
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if not isinstance(value, dict) or depth > _DEEPEST:
        raise WireError(type(value).__name__)

    def all_of(items: Any) -> list[Any]:
        return [unpack(item, objects, memory, depth + 1) for item in items]

    if "object" in value:
        if "facts" in value:
            value = {**value, "facts": unpack(value["facts"], objects, memory, depth + 1)}
        return objects.resolve(value)
    if "bytes" in value:
        return bytes(_part(memory, value["bytes"]))
    if "list" in value:
        return all_of(value["list"])
    if "tuple" in value:
        return tuple(all_of(value["tuple"]))
    if "set" in value:
        return frozenset(all_of(value["set"]))
    if "dict" in value:
        return dict(map(all_of, value["dict"]))
    if "array" in value:
        return _unpack_array(value, memory)
    if "rng" in value:
        return _generator(unpack(value["rng"], objects, memory, depth + 1))
    if "enum" in value:
        return _class_by_name(value["enum"], objects, lambda cls: issubclass(cls, enum.Enum))[value["name"]]
    if "record" in value:
        cls = _class_by_name(value["record"], objects, lambda cls: _record_type(cls) is not None)
        return cls(**{name: unpack(item, objects, memory, depth + 1) for name, item in value["fields"].items()})
    if "other" in value:
        return type(str(value["other"])[:100], (), {})()
    raise WireError(f"an object with {', '.join(map(str, value))}")


def _append(payload: Payload, content: bytes | memoryview) -> list[int]:
    """Append content to the payload; return its offset and size."""
    payload.append(content)
    return [sum(map(len, payload)) - len(content), len(content)]


def _part(memory: memoryview, place: Any) -> memoryview:
    begin, size = place
    if not 0 <= begin <= begin + size <= len(memory):
        raise WireError(f"bytes {begin} to {begin + size} of {len(memory)}")
    return memory[begin : begin + size]


def _pack_array(value: Any, payload: Payload) -> Any:
    """Pack an array, number or random generator of NumPy; None for anything else."""
    numpy = sys.modules.get("numpy")  # loaded if there is an array
    if numpy is None:
        return None
    kind = type(value)
    if issubclass(kind, numpy.generic):
        return _pack_array(numpy.asarray(value), payload) if value.dtype.hasobject else value.item()
    if issubclass(kind, numpy.random.Generator):
        seed, state = value.bit_generator.seed_seq, value.bit_generator.state
        named = {"entropy": seed.entropy, "spawn_key": seed.spawn_key, "n_children_spawned": seed.n_children_spawned}
        return {"rng": pack({"seed": named, "state": state}, _NoObjects(), payload)}
    if not issubclass(kind, numpy.ndarray):
        return None
    if value.dtype.hasobject or value.dtype.names:
        return {"other": f"{kind.__name__} of dtype {value.dtype}"}
    plain = numpy.array(value, order="C", subok=False, copy=not value.flags.c_contiguous)
    content = memoryview(plain).cast("B") if plain.size else b""
    return {"array": _append(payload, content), "dtype": value.dtype.str, "shape": list(value.shape)}


def _unpack_array(value: dict[str, Any], memory: memoryview) -> Any:
    import numpy as np  # only hosts that are sent arrays load it

    dtype = np.dtype(str(value["dtype"]))
    if dtype.hasobject:
        raise WireError("an array of objects")
    return np.frombuffer(bytearray(_part(memory, value["array"])), dtype).reshape([int(n) for n in value["shape"]])


def _generator(state: dict[str, Any]) -> Any:
    import numpy as np  # only hosts that are sent arrays load it

    rng = np.random.default_rng(np.random.SeedSequence(**state["seed"]))
    rng.bit_generator.state = state["state"]
    return rng


def _record_type(kind: type) -> str | None:
    """Return the qualified name of a dataclass or named tuple of codecbench, or None."""
    known = kind.__module__.startswith(_OURS) and (is_dataclass(kind) or hasattr(kind, "_fields"))
    return f"{kind.__module__}:{kind.__qualname__}" if known else None


def _names(kind: Any) -> list[str]:
    """Return the fields that define a record, without cached ones."""
    return list(kind._fields) if hasattr(kind, "_fields") else [f.name for f in fields(kind) if f.init and f.compare]


def _class_by_name(name: Any, objects: Objects, is_allowed: Callable[[type], bool]) -> Any:
    """Return a class of codecbench by its qualified name; imports its module only if the other side is obeyed."""
    module, _, qualified = str(name).partition(":")
    if objects.obeys and module.startswith(_OURS):
        importlib.import_module(module)
    cls: Any = sys.modules.get(module) if module.startswith(_OURS) else None
    for part in qualified.split("."):
        cls = vars(cls).get(part) if cls is not None else None
    if not isinstance(cls, type) or not is_allowed(cls):
        raise WireError(f"{str(name)[:100]} is not a record")
    return cls


class _NoObjects:
    obeys = False

    def refer(self, value: object) -> None:
        return None

    def resolve(self, reference: dict[str, Any]) -> Any:
        raise WireError("an object")
