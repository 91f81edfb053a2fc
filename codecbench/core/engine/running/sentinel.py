"""Whether a worker still computes right after code of other distributions ran in it."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, Final

import numpy as np

from codecbench.core.contracts.errors import CodecbenchError, PluginError, Unsupported
from codecbench.core.contracts.evaluator import (
    CodedFrame,
    Context,
    Evaluator,
    Measurement,
    SentPacket,
    SequenceEvaluator,
)
from codecbench.core.contracts.features import Features
from codecbench.core.contracts.hooks import Kind
from codecbench.core.contracts.sequence import Frame, FrameSequence
from codecbench.core.engine.registry import Registry

_WATCHED: Final = ("codecbench", "numpy", "cv2", "scipy", "skimage")
_WATCHED_ALONE: Final = ("builtins", "math", "time", "random", "struct", "zlib", "json", "os")
_SHOWN: Final = 3


class Tampering(PluginError):
    """Code of another distribution changed what the rest of its process computes with."""


class Sentinel:
    """Made before code of other distributions is imported: what our evaluators answer, and which functions there are.

    registry: of codecbench's own plugins.
    """

    def __init__(self, registry: Registry) -> None:
        self._evaluators = list(_cheap_evaluators(registry))
        self._answers = dict(self._answered())  # first, because it imports what is watched next
        self._functions = dict(_functions())

    def check(self, company: tuple[str, ...]) -> None:
        """Raise Tampering, which names the company, where anything is not as it was."""
        now = dict(_functions())
        replaced = sorted(name for name, function in self._functions.items() if now.get(name) is not function)
        if replaced:
            more = f" and {len(replaced) - _SHOWN} more" if len(replaced) > _SHOWN else ""
            what = f"replaced {', '.join(replaced[:_SHOWN])}{more} in its process"
        elif (wrong := self._wrong()) is not None:
            what = f"changed what evaluator {wrong} measures of a known picture in its process"
        else:
            return
        raise Tampering(f"code of {' or '.join(company)} {what}; nothing that ran there can be trusted")

    def _wrong(self) -> str | None:
        """The first evaluator that answers otherwise. Those after it are not asked, for they may not survive that."""
        return next((name for name, answer in self._answered() if answer != self._answers[name]), None)

    def _answered(self) -> Iterator[tuple[str, str]]:
        """What each evaluator measures of the known picture, or that it fails, spelled out."""
        for evaluator in self._evaluators:
            try:
                yield evaluator.name, repr(known_measurements(evaluator))
            except Exception as error:  # noqa: BLE001 - patched libraries may raise anything, which is an answer too
                yield evaluator.name, f"{type(error).__name__}: {error}"


class KnownSequence(FrameSequence):
    """Two gray pictures of 96x128 with edges and a ramp, the second shifted."""

    name, channels, frame_rate_hz, camera, ground_truth, fingerprint = "known", 1, 10.0, None, None, "known"
    timestamps_s = np.array([0.0, 0.1])

    def read(self, index: int) -> Frame:
        rows, columns = np.mgrid[:96, :128]
        columns = columns + 2 * index
        image = (rows * 5 + columns * 3 + 90 * ((rows // 8 + columns // 8) % 2)) % 256
        return Frame(index, float(self.timestamps_s[index]), image.astype(np.uint8))


class KnownCoded:
    """The known sequence without the three lower bits, which cost a hundred bytes a frame."""

    sequence = KnownSequence()
    codec: Any = SimpleNamespace(carries="pictures", stateless=True)

    def __len__(self) -> int:
        return len(self.sequence)

    def __iter__(self) -> Iterator[CodedFrame]:
        return (self.frame(index) for index in range(len(self)))

    def frame(self, index: int) -> CodedFrame:
        original = self.sequence.read(index)
        return CodedFrame(original, bytes(100), original.image & np.uint8(0xF8))

    def features(self, index: int) -> Features:
        raise Unsupported("pictures are known, not features")

    def size_bytes(self, index: int) -> int:
        return 100

    @property
    def packets(self) -> tuple[SentPacket, ...]:
        return tuple(SentPacket(index, 100, True, index + 1) for index in range(len(self)))

    def sender(self) -> KnownCoded:
        return self

    def send(self, index: int) -> CodedFrame:
        return self.frame(index)


class _NoPlugins:
    def create(self, kind: Kind, name: str, params: dict[str, Any]) -> Any:
        raise PluginError(f"{kind} {name} is not declared")


def known_measurements(evaluator: SequenceEvaluator[Any]) -> list[Measurement]:
    """What an evaluator measures of the known sequence."""
    with tempfile.TemporaryDirectory(prefix="codecbench-known-") as folder:
        context = Context(np.random.default_rng(0), 0, Path(folder), _NoPlugins())
        return list(evaluator.evaluate(KnownCoded(), context))


def _cheap_evaluators(registry: Registry) -> Iterator[SequenceEvaluator[Any]]:
    """Those of coded sequences that need nothing but pictures."""
    for plugin in registry.plugins("evaluator"):
        try:
            evaluator: Evaluator[Any] = registry.create("evaluator", plugin.spec.name, {})
        except (CodecbenchError, ValueError):
            continue
        if isinstance(evaluator, SequenceEvaluator) and not evaluator.needs and not evaluator.uses:
            yield evaluator


def _functions() -> Iterator[tuple[str, Any]]:
    """Functions and classes of the watched modules that are loaded, and the functions of our classes."""
    for name, module in list(sys.modules.items()):
        if isinstance(module, ModuleType) and (name in _WATCHED_ALONE or name.partition(".")[0] in _WATCHED):
            for attribute, value in list(vars(module).items()):
                if callable(value):
                    yield f"{name}.{attribute}", value
                if isinstance(value, type) and value.__module__ == name and name.startswith("codecbench."):
                    for member, function in list(vars(value).items()):
                        if callable(function):
                            yield f"{name}.{attribute}.{member}", function
