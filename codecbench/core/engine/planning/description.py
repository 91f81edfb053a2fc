"""What a plan needs to know of plugins, as data: asked of each in this process or in its host."""

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
from codecbench.core.contracts.params import Params
from codecbench.core.contracts.sequence import FrameSequence
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


class InvalidParams(Exception):
    """Parameters that a plugin does not take: pydantic's errors, and the names that it knows."""

    def __init__(self, details: list[dict[str, Any]], fields: list[str]) -> None:
        super().__init__(f"{len(details)} invalid parameter(s)")
        self.details, self.fields = details, fields

    @property
    def sentence(self) -> str:
        """What is wrong, for errors that have no place in a file to point at."""
        wrong = []
        for detail in self.details:
            name = ".".join(str(step) for step in detail["loc"])
            unknown = detail["type"] == "extra_forbidden"
            what = f"unknown; {suggest(name, self.fields)}" if unknown else error_text(detail)
            wrong.append(f"{name}: {what}" if name else what)
        return "; ".join(wrong)


def error_text(detail: Any) -> str:
    """One of pydantic's errors in words, with what it got where that is one short value."""
    got = detail.get("input")
    message = str(detail["msg"]).removeprefix("Value error, ")
    shown = repr(got)
    return message if isinstance(got, Mapping) or len(shown) > 80 else f"{message}; got {shown}"


@dataclass(frozen=True)
class Description:
    """One setting of a plugin.

    params: complete, as JSON types. explicit: names of those that are not at their default. identities: what
    distinguishes each repeat, without parameters at their default; empty where `missing` says why there is no instance.
    inert: see PluginSetting. declared: what it says of its meaning, see `planning.declared`. channels: of a codec.
    uses: kind, name and parameters of the plugins that an evaluator runs. runs_codec: it is a CodecEvaluator.
    requires: parameters for which stands what other evaluators measure, with the quantity of their metric.
    """

    version: str
    params: dict[str, Any]
    explicit: list[str] = field(default_factory=list)
    identities: list[dict[str, Any]] = field(default_factory=list)
    inert: list[str] = field(default_factory=list)
    missing: str | None = None
    declared: dict[str, Any] = field(default_factory=dict)
    channels: list[int] = field(default_factory=list)
    needs: list[str] = field(default_factory=list)
    exclusive: bool = False
    runs_codec: bool = False
    uses: list[tuple[Kind, str, dict[str, Any]]] = field(default_factory=list)
    requires: dict[str, str] = field(default_factory=dict)

    def setting(self, kind: Kind, name: str, distribution: str) -> PluginSetting:
        """The setting that is described. distribution: where the plugin is from, empty for codecbench's own."""
        return PluginSetting(kind, name, self.version, self.params, inert=tuple(self.inert), distribution=distribution)


def describe(
    registry: Registry, kind: Kind, name: str, values: dict[str, Any], folder: str | None = None
) -> Description:
    """The description of a plugin with these parameters; paths in them start at `folder`.

    Raises InvalidParams, Unsupported where it cannot be used here, and PluginError where it breaks the contract.
    """
    asked = repr((kind, name, values, folder))
    if (answer := registry.told.get(asked)) is None:
        answer = registry.ask(description_fields, kind, name, values, folder, of=[(kind, name)])
        if registry.find(kind, name).hosted:
            registry.told[asked] = answer
    try:
        if "invalid" in answer:
            raise InvalidParams(answer["invalid"], answer["fields"])
        canonical_json(answer)
    except (TypeError, ValueError) as error:
        raise PluginFault(
            f"{registry.find(kind, name).title}: it says of itself what has no spelling: {error}"
        ) from None
    return Description(**{**answer, "declared": clean_value(answer.get("declared", {}))})


def description_fields(
    registry: Registry, kind: Kind, name: str, values: dict[str, Any], folder: str | None
) -> dict[str, Any]:
    """The fields of a Description as JSON types, or `invalid` with pydantic's errors and `fields`."""
    cls = registry.load(kind, name)
    try:
        params = cls.params_type.model_validate(values, context={"relative_to": folder} if folder else None)
    except ValidationError as error:
        return {"invalid": [_plain(detail) for detail in error.errors()], "fields": list(cls.params_type.model_fields)}
    found: dict[str, Any] = {
        "version": _version(cls),
        "params": params.model_dump(mode="json"),
        "explicit": list(params.model_dump(exclude_defaults=True)),
    }
    if kind not in _CONSTRUCTED:
        return {**found, **_identities(params, [params.identity()])}
    try:
        instance = cls(params)
    except Unsupported as error:
        unknown = {} if kind == "evaluator" else _identities(params, [params.identity()])
        return {**found, **unknown, "missing": str(error)}
    if kind == "evaluator":
        return {**found, **_evaluator(instance, params)}
    found |= _identities(params, [params.identity()])
    if kind == "codec":
        found |= {"declared": codec_declaration(instance), "channels": _channels(instance)}
    return found


def _evaluator(evaluator: Any, params: Params) -> dict[str, Any]:
    for metric in evaluator.metrics:
        if clean_line(metric.name) != metric.name or len(metric.name) > _LONGEST_NAME:
            raise PluginError(f"metric {metric.name[:40]!r}... has a name that is not short and plain text")
    if not 1 <= evaluator.repeats <= _MOST_REPEATS:
        raise PluginError(f"{type(evaluator).__name__}.repeats is {evaluator.repeats}; it is 1 to {_MOST_REPEATS}")
    return {
        **_identities(params, [evaluator.repeat_identity(repeat) for repeat in range(evaluator.repeats)]),
        "declared": evaluator_declaration(evaluator),
        "needs": sorted(evaluator.needs),
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


def _channels(codec: Any) -> list[int]:
    channels = [int(count) for count in codec.capabilities.channels]
    if not channels or not {1, 3}.issuperset(channels):
        raise PluginError(f"{type(codec).__name__}.capabilities.channels is {channels}; it holds 1, 3 or both")
    return channels


def _version(cls: Any) -> str:
    version = cls.version
    if not isinstance(version, str):
        raise PluginError(f"{cls.__name__}.version is {version!r}; it is a string")
    if clean_line(version) != version:
        raise PluginError(f"{cls.__name__}.version is {version[:40]!r}...; it is short and plain text")
    return version


def _plain(detail: Any) -> dict[str, Any]:
    """One of pydantic's errors as JSON types, without the exception that it may hold."""
    got = detail.get("input")
    try:
        json.dumps(got, allow_nan=False)
    except (TypeError, ValueError):
        got = repr(got)
    return {"input": got, **{name: detail.get(name) for name in ("type", "loc", "msg")}}


def describe_sequence(registry: Registry, name: str, params: dict[str, Any]) -> dict[str, Any]:
    """What a plan keeps of a dataset's sequence, which is opened. Raises DatasetError."""
    sequence = registry.create("dataset", name, params).open()
    if not isinstance(sequence, FrameSequence):
        raise PluginError(f"open returned {type(sequence).__name__}; it returns a FrameSequence")
    found = {"name": sequence.name, "fingerprint": sequence.fingerprint}
    for attribute, value in found.items():
        if not isinstance(value, str) or not value:
            raise PluginError(f"{type(sequence).__name__}.{attribute} is {value!r}; it is a string")
    _check_frames(sequence)
    return {
        **found,
        "name": clean_line(sequence.name),
        "frames": len(sequence),
        "channels": int(sequence.channels),
        "has_camera": sequence.camera is not None,
        "has_ground_truth": sequence.ground_truth is not None,
        "notes": _notes(sequence),
        "as_calibrated": clean_line(str(sequence.as_calibrated)),
        "frame_rate_hz": rate_hz if math.isfinite(rate_hz := float(sequence.frame_rate_hz)) else 0.0,
    }


def _notes(sequence: FrameSequence) -> list[str]:
    notes = sequence.notes
    if not isinstance(notes, tuple) or not all(isinstance(note, str) for note in notes):
        raise PluginError(f"{type(sequence).__name__}.notes is {type(notes).__name__}; it is a tuple of strings")
    return [clean_line(note) for note in notes[:_MOST_NOTES]]


def _check_frames(sequence: FrameSequence) -> None:
    """Raise PluginError for a sequence whose frames cannot be read in order."""
    title, frames = type(sequence).__name__, len(sequence)
    if frames == 0:
        raise PluginError(f"{title} has no frames")
    if sequence.channels not in (1, 3):
        raise PluginError(f"{title}.channels is {sequence.channels!r}; it is 1 or 3")
    stamps_s = np.asarray(sequence.timestamps_s, np.float64)
    if stamps_s.shape != (frames,):
        raise PluginError(f"{title}.timestamps_s has shape {stamps_s.shape}; there are {frames} frames")
    if not (np.isfinite(stamps_s).all() and (np.diff(stamps_s) > 0).all()):
        raise PluginError(f"{title}.timestamps_s are not finite and strictly increasing")


def without_defaults(identity: dict[str, Any], params: Params) -> dict[str, Any]:
    """What a plugin says distinguishes a setting, less the parameters that are at their default.

    A parameter that is added with a default so changes no identity. Entries that are not a parameter's value as it
    stands stay, and so does everything where the rest would not validate to the same parameters (a union told apart
    by a default).
    """
    full = params.model_dump(mode="json")
    brief = params.model_dump(mode="json", exclude_defaults=True)
    if not _means(brief, params):
        return identity
    kept = {}
    for name, value in identity.items():
        if name not in full or value != full[name]:
            kept[name] = value
        elif name in brief:
            kept[name] = brief[name]
    return kept


def _means(values: dict[str, Any], params: Params) -> bool:
    """Whether these values validate to the very parameters."""
    try:
        return type(params).model_validate(values) == params
    except ValidationError:
        return False


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
