"""Ask plugins, in this process or in their hosts, for everything that a plan needs, and return it as data."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from pydantic import ValidationError

from codecbench.core.contracts.codec import AnyCodec
from codecbench.core.contracts.errors import ParamsError, PluginError, Unsupported
from codecbench.core.contracts.evaluator import CodecEvaluator
from codecbench.core.contracts.hooks import Kind
from codecbench.core.contracts.image import LAYOUTS
from codecbench.core.contracts.params import Params
from codecbench.core.contracts.sequence import Depth, FrameSequence
from codecbench.core.engine.hosting.host import PluginFault
from codecbench.core.engine.identity import canonical_json
from codecbench.core.engine.planning.declared import codec_declaration, evaluator_declaration
from codecbench.core.engine.planning.model import PluginSetting
from codecbench.core.engine.planning.yaml_file import suggest
from codecbench.core.engine.plugins.registry import Registry, installed
from codecbench.core.engine.text import clean_line, clean_value

_CONSTRUCTED: Final = ("codec", "evaluator", "slam_backend", "executor", "link")
_MOST_REPEATS: Final = 100_000
_LONGEST_NAME: Final = 100
_MOST_NOTES: Final = 20
_CHANNELS: Final = (1, 3)
_BITS: Final = (8, 16)


class InvalidParams(Exception):
    """Raised if a plugin rejects parameters; carries pydantic's errors and the allowed names."""

    def __init__(self, details: list[dict[str, Any]], fields: list[str]) -> None:
        super().__init__(f"{len(details)} invalid parameter(s)")
        self.details, self.fields = details, fields

    @property
    def sentence(self) -> str:
        """All errors in one line, for callers that have no file position to show."""
        parts = []
        for detail in self.details:
            name = ".".join(str(step) for step in detail["loc"])
            unknown = detail["type"] == "extra_forbidden"
            message = f"unknown; {suggest(name, self.fields)}" if unknown else error_text(detail)
            parts.append(f"{name}: {message}" if name else message)
        return "; ".join(parts)


def error_text(detail: Any) -> str:
    """Format one of pydantic's errors, with the rejected value if it is a short scalar."""
    value = detail.get("input")
    message = str(detail["msg"]).removeprefix("Value error, ")
    text = repr(value)
    return message if isinstance(value, Mapping) or len(text) > 80 else f"{message}; got {text}"


@dataclass(frozen=True)
class Description:
    """One setting of a plugin."""

    version: str
    params: dict[str, Any]
    """Complete parameters as JSON types."""
    explicit: list[str] = field(default_factory=list)
    """Names of the parameters that differ from their defaults."""
    identities: list[dict[str, Any]] = field(default_factory=list)
    """Identity of each repeat without parameters at their default; empty if `missing` is set."""
    inert: list[str] = field(default_factory=list)
    """See `PluginSetting`."""
    missing: str | None = None
    """Why the plugin cannot be instantiated here, or None."""
    declared: dict[str, Any] = field(default_factory=dict)
    """See `planning.declared`."""
    layouts: list[list[int]] = field(default_factory=list)
    """Layouts that a codec accepts: channels and bits of each."""
    bits: list[int] = field(default_factory=list)
    """Bits of the samples that an evaluator reads."""
    needs: list[str] = field(default_factory=list)
    exclusive: bool = False
    runs_codec: bool = False
    """Whether it is a CodecEvaluator."""
    uses: list[tuple[Kind, str, dict[str, Any]]] = field(default_factory=list)
    """Kind, name and parameters of the plugins that an evaluator runs."""
    requires: dict[str, str] = field(default_factory=dict)
    """Parameters whose value another evaluator measures, with the quantity of its metric."""

    def setting(self, kind: Kind, name: str, distribution: str) -> PluginSetting:
        """Return the described setting. distribution: origin of the plugin, empty for codecbench's own."""
        return PluginSetting(kind, name, self.version, self.params, inert=tuple(self.inert), distribution=distribution)


def describe(
    registry: Registry, kind: Kind, name: str, values: dict[str, Any], folder: str | None = None
) -> Description:
    """Describe a plugin with these parameters. folder: base of relative paths in them.

    Raises InvalidParams, Unsupported if the plugin cannot be used here, and PluginError if it violates its contract.
    """
    key = repr((kind, name, values, folder))
    if (answer := registry.answers.get(key)) is None:
        answer = registry.ask(description_fields, kind, name, values, folder, of=[(kind, name)])
        if registry.find(kind, name).hosted:
            registry.answers[key] = answer
    try:
        if "invalid" in answer:
            raise InvalidParams(answer["invalid"], answer["fields"])
        canonical_json(answer)
    except (TypeError, ValueError) as error:
        raise PluginFault(f"{registry.find(kind, name).title}: its description is not valid JSON: {error}") from None
    return Description(**{**answer, "declared": clean_value(answer.get("declared", {}))})


def description_fields(
    registry: Registry, kind: Kind, name: str, values: dict[str, Any], folder: str | None
) -> dict[str, Any]:
    """Return the fields of a Description as JSON types, or pydantic's errors as `invalid`, with `fields`."""
    cls = registry.load(kind, name)
    try:
        params = cls.params_type.model_validate(values, context={"relative_to": folder} if folder else None)
    except ValidationError as error:
        return {"invalid": [_plain(detail) for detail in error.errors()], "fields": list(cls.params_type.model_fields)}
    fields: dict[str, Any] = {
        "version": _version(cls),
        "params": params.model_dump(mode="json"),
        "explicit": list(params.model_dump(exclude_defaults=True)),
    }
    if kind not in _CONSTRUCTED:
        return {**fields, **_identities(params, [params.identity()])}
    try:
        instance = cls(params)
    except Unsupported as error:
        unknown = {} if kind == "evaluator" else _identities(params, [params.identity()])
        return {**fields, **unknown, "missing": str(error)}
    if kind == "evaluator":
        return {**fields, **_evaluator(instance, params)}
    fields |= _identities(params, [params.identity()])
    if kind == "codec":
        fields |= {"declared": codec_declaration(instance), "layouts": _layouts(instance)}
    return fields


def _evaluator(evaluator: Any, params: Params) -> dict[str, Any]:
    for metric in evaluator.metrics:
        if clean_line(metric.name) != metric.name or len(metric.name) > _LONGEST_NAME:
            raise PluginError(f"the name of metric {metric.name[:40]!r}... is not short and plain text")
    if not 1 <= evaluator.repeats <= _MOST_REPEATS:
        raise PluginError(f"{type(evaluator).__name__}.repeats is {evaluator.repeats}; it must be 1 to {_MOST_REPEATS}")
    return {
        **_identities(params, [evaluator.repeat_identity(repeat) for repeat in range(evaluator.repeats)]),
        "declared": evaluator_declaration(evaluator),
        "needs": sorted(evaluator.needs),
        "bits": _numbers(f"{type(evaluator).__name__}.bits", evaluator.bits, _BITS),
        "exclusive": bool(evaluator.exclusive),
        "runs_codec": isinstance(evaluator, CodecEvaluator),
        "uses": [(use.kind, use.name, use.params) for use in evaluator.uses],
        "requires": dict(evaluator.requires),
    }


def _identities(params: Params, identities: list[dict[str, Any]]) -> dict[str, Any]:
    full = params.model_dump(mode="json")
    inert = [
        name for name in full if any(name not in identity or identity[name] != full[name] for identity in identities)
    ]
    return {"identities": [without_defaults(identity, params) for identity in identities], "inert": inert}


def _layouts(codec: Any) -> list[list[int]]:
    where, capabilities = f"{type(codec).__name__}.capabilities", codec.capabilities
    _numbers(f"{where}.channels", capabilities.channels, _CHANNELS)
    _numbers(f"{where}.bits", capabilities.bits, _BITS)
    if not capabilities.layouts:
        raise PluginError(f"{where} accepts no frames: images of 16 bits are gray; add 1 to channels or 8 to bits")
    return [list(layout) for layout in capabilities.layouts]


def _numbers(where: str, numbers: Any, allowed: tuple[int, int]) -> list[int]:
    """Return numbers as a list. Raises PluginError if it is empty or has others than the two that are allowed."""
    found = [int(number) for number in numbers]
    if not found or not set(allowed).issuperset(found):
        raise PluginError(f"{where} is {found}; it must contain {allowed[0]}, {allowed[1]} or both")
    return found


def _version(cls: Any) -> str:
    version = cls.version
    if not isinstance(version, str):
        raise PluginError(f"{cls.__name__}.version is {version!r}; it must be a string")
    if clean_line(version) != version:
        raise PluginError(f"{cls.__name__}.version is {version[:40]!r}...; it must be short and plain text")
    return version


def _plain(detail: Any) -> dict[str, Any]:
    """Convert one of pydantic's errors to JSON types, without the exception that it may contain."""
    value = detail.get("input")
    try:
        json.dumps(value, allow_nan=False)
    except (TypeError, ValueError):
        value = repr(value)
    return {"input": value, **{name: detail.get(name) for name in ("type", "loc", "msg")}}


def describe_sequence(registry: Registry, name: str, params: dict[str, Any]) -> dict[str, Any]:
    """Open a dataset's sequence and return what a plan stores about it. Raises DatasetError."""
    sequence = registry.create("dataset", name, params).open()
    if not isinstance(sequence, FrameSequence):
        raise PluginError(f"open returned {type(sequence).__name__}; it must return a FrameSequence")
    facts = {"name": sequence.name, "fingerprint": sequence.fingerprint}
    for attribute, value in facts.items():
        if not isinstance(value, str) or not value:
            raise PluginError(f"{type(sequence).__name__}.{attribute} is {value!r}; it must be a string")
    _check_frames(sequence)
    return {
        **facts,
        "name": clean_line(sequence.name),
        "frames": len(sequence),
        "channels": int(sequence.channels),
        "has_camera": sequence.camera is not None,
        "has_ground_truth": sequence.ground_truth is not None,
        "notes": _notes(sequence),
        "as_calibrated": clean_line(str(sequence.as_calibrated)),
        "bits": int(sequence.bits),
        "has_depth": sequence.depth is not None,
        "frame_rate_hz": rate_hz if math.isfinite(rate_hz := float(sequence.frame_rate_hz)) else 0.0,
    }


def _notes(sequence: FrameSequence) -> list[str]:
    notes = sequence.notes
    if not isinstance(notes, tuple) or not all(isinstance(note, str) for note in notes):
        raise PluginError(f"{type(sequence).__name__}.notes is {type(notes).__name__}; it must be a tuple of strings")
    return [clean_line(note) for note in notes[:_MOST_NOTES]]


def _check_frames(sequence: FrameSequence) -> None:
    """Raise PluginError if the frames of a sequence cannot be read in order."""
    title, frames = type(sequence).__name__, len(sequence)
    if frames == 0:
        raise PluginError(f"{title} has no frames")
    if sequence.channels not in _CHANNELS:
        raise PluginError(f"{title}.channels is {sequence.channels!r}; it must be 1 or 3")
    if sequence.layout not in LAYOUTS:
        fault = f"{title} has {sequence.channels!r} channel(s) of {sequence.bits!r} bits"
        raise PluginError(f"{fault}; bits must be 8, or 16 with one channel")
    _check_depth(title, sequence)
    stamps_s = np.asarray(sequence.timestamps_s, np.float64)
    if stamps_s.shape != (frames,):
        raise PluginError(f"{title}.timestamps_s has shape {stamps_s.shape}; there are {frames} frames")
    if not (np.isfinite(stamps_s).all() and (np.diff(stamps_s) > 0).all()):
        raise PluginError(f"{title}.timestamps_s are not finite and strictly increasing")


def _check_depth(title: str, sequence: FrameSequence) -> None:
    """Raise PluginError if what a sequence says of its pixels is not valid."""
    depth = sequence.depth
    if depth is None:
        return
    if type(depth) is not Depth or not 0.0 < depth.unit_m < math.inf or not 0 <= depth.unknown < 1 << 16:
        raise PluginError(f"{title}.depth is {depth!r}; it must be a Depth of a positive unit and a 16-bit value")
    if sequence.bits != 16:
        raise PluginError(f"{title} has depth of {sequence.bits} bits; depth has 16")


def without_defaults(identity: dict[str, Any], params: Params) -> dict[str, Any]:
    """Return a setting's identity without the parameters that are at their default.

    So adding a parameter with a default changes no identity. Entries that are not a parameter's plain value stay.
    Everything stays if the rest would not validate to the same parameters, as with a union that a default tells apart.
    """
    full = params.model_dump(mode="json")
    non_default = params.model_dump(mode="json", exclude_defaults=True)
    if not _means(non_default, params):
        return identity
    distinct = {}
    for name, value in identity.items():
        if name not in full or value != full[name]:
            distinct[name] = value
        elif name in non_default:
            distinct[name] = non_default[name]
    return distinct


def _means(values: dict[str, Any], params: Params) -> bool:
    """Whether these values validate to exactly these parameters."""
    try:
        return type(params).model_validate(values) == params
    except ValidationError:
        return False


def codec(name: str, **params: Any) -> AnyCodec[Any]:
    """Create an installed codec from its name in a matrix and its parameters, for scripts and notebooks.

    Raises PluginError with the nearest name if it is unknown, ParamsError for parameters that it rejects, and
    Unsupported, with the command to install it, if a library is missing.
    """
    registry = installed()
    try:
        describe(registry, "codec", name, params)
    except InvalidParams as invalid:
        sequences = [key for key, value in params.items() if isinstance(value, list | tuple | range)]
        hint = f"; one value is wanted of {', '.join(sequences)}: make a codec of each, or a grid in a matrix"
        raise ParamsError(f"codec {name}: {invalid.sentence}{hint if sequences else ''}") from None
    instance: AnyCodec[Any] = registry.create("codec", name, params)
    return instance
