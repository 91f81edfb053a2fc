"""The evaluator contract: what is measured, on what, and how it is declared.

Three kinds differ in what they are handed: a FrameEvaluator one coded frame at a time, a SequenceEvaluator
the whole coded sequence in order, a CodecEvaluator the codec itself (to time or trace it). All yield
Measurements of metrics that the class declared; an undeclared one fails the cell.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Literal, Protocol

import numpy as np

from codecbench.core.contracts.codec import AnyCodec
from codecbench.core.contracts.errors import PluginError
from codecbench.core.contracts.features import Features
from codecbench.core.contracts.former_names import former_names
from codecbench.core.contracts.hooks import Kind
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.metric import Metric, Quantity
from codecbench.core.contracts.params import Configured, P
from codecbench.core.contracts.sequence import Frame, FrameSequence
from codecbench.core.contracts.stream import Packet
from codecbench.core.contracts.view import Drawing, KeypointOverlay, View


@dataclass(frozen=True)
class Measurement:
    """One value of one metric; `frame` and `stage` where it belongs to one.

    A stage is `encode` or `decode`, or one of their parts: `encode/dct`. A value may be infinite (identical
    images) but a NaN must come with a reason: it then is a missing value and never a number.
    """

    metric: str
    value: float
    frame: int | None = None
    stage: str | None = None
    reason: str | None = None


@dataclass(frozen=True)
class CodedFrame:
    """A frame beside what became of it."""

    original: Frame
    bitstream: bytes = field(repr=False)
    decoded: Image = field(repr=False)

    @cached_property
    def size_bytes(self) -> int:
        return len(self.bitstream)


@dataclass(frozen=True)
class SentPacket:
    """A packet of a coded sequence.

    frame: index of its frame. starts: whether decoding can start at it. after: how many frames the encoder had been
    given when it came out: a packet that came at once has `frame + 1`. recovery_frames: as of a `Packet`. session: of
    the encoder's sessions, the one that it is of, where a sender that adapts begins others.
    """

    frame: int
    size_bytes: int
    starts: bool
    after: int
    recovery_frames: int | None = None
    session: int = 0

    def packet(self, data: bytes) -> Packet:
        """With its bytes, as a decoder gets it."""
        return Packet(data, self.frame, self.starts, self.recovery_frames)


class FrameSender(Protocol):
    """Codes frames of a sequence as they are chosen, in any number and in rising order."""

    def send(self, index: int) -> CodedFrame:
        """The frame, coded after those that were sent before; one of these is given again, and not sent twice.

        Raises Unsupported for a codec with memory that holds the frame back, or has sent a later one.
        """
        ...


class CodedSequence(Protocol):
    """All frames of a sequence under one codec setting; frames are read and decoded as they are asked for."""

    @property
    def sequence(self) -> FrameSequence: ...

    @property
    def codec(self) -> AnyCodec[Any]: ...

    @property
    def packets(self) -> tuple[SentPacket, ...]:
        """What was sent, in that order."""
        ...

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[CodedFrame]: ...

    def frame(self, index: int) -> CodedFrame:
        """Raises Unsupported for a codec of features, as iterating does: there is no picture."""
        ...

    def features(self, index: int) -> Features:
        """What a codec of features has of a frame when it was decoded; raises Unsupported for a codec of pictures."""
        ...

    def size_bytes(self, index: int) -> int:
        """Size of one frame's bitstream, without decoding it."""
        ...

    def sender(self) -> FrameSender:
        """A sender of chosen frames alone: with a codec that has memory, they make a stream of their own.

        Raises Unsupported for a codec of features.
        """
        ...


@dataclass(frozen=True)
class PluginUse:
    """Another plugin that an evaluator runs, so that its version enters the identity of the cell."""

    kind: Kind
    name: str
    params: dict[str, Any] = field(default_factory=dict)


class PluginSource(Protocol):
    """Where an evaluator gets the plugins that it declared in `uses`."""

    def create(self, kind: Kind, name: str, params: dict[str, Any]) -> Any: ...


@former_names(awaited="inputs")
@dataclass(frozen=True)
class Context:
    """What a cell may use besides what it measures.

    rng: seeded from the cell's identity. repeat: 0-based. artifacts: an existing folder; files written there
    are kept beside the record. plugins: creates plugins that the evaluator declared in `uses`. inputs: for each
    parameter that it declared in `requires`, the median of what was measured.
    """

    rng: np.random.Generator
    repeat: int
    artifacts: Path
    plugins: PluginSource
    inputs: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Outcome:
    """A finished cell as another may look at it: its repeat, its measurements, and its artifacts' folder."""

    repeat: int
    measurements: tuple[Measurement, ...]
    artifacts: Path

    def value(self, metric: str) -> float:
        """The value of a metric measured once; NaN where it is missing."""
        return next((m.value for m in self.measurements if m.metric == metric), float("nan"))


class Evaluator(Configured[P]):
    """Base of the three kinds of evaluator; subclass one of those.

    metrics: everything that `evaluate` and `compare` may yield. views: what it offers to draw of them, beyond
    what their roles say. needs: what the sequence must have. exclusive: nothing else may run on the machine meanwhile.
    kernels: the packages and modules whose listed kernels it calls, which a run compiles ahead.
    typical_ms_per_frame: of a cell on a 640x480 colour frame, decoding included, for estimates before anything is
    measured; None for evaluators that look at a few frames, whatever the length of the sequence.
    """

    metrics: ClassVar[tuple[Metric, ...]]
    views: ClassVar[tuple[View, ...]] = ()
    needs: ClassVar[frozenset[Literal["camera", "ground_truth"]]] = frozenset()
    exclusive: ClassVar[bool] = False
    kernels: ClassVar[tuple[str, ...]] = ()
    typical_ms_per_frame: ClassVar[float | None] = None

    def __init_subclass__(cls, **options: Any) -> None:
        """Raise PluginError where metrics and views name metrics that are not declared, or one twice."""
        super().__init_subclass__(**options)
        names = [metric.name for metric in getattr(cls, "metrics", ())]
        meant = [(f"metric {metric.name!r}", other) for metric in getattr(cls, "metrics", ())
                 for other in (metric.confirmed_by, metric.in_units_of) if other]  # fmt: skip
        meant += [(f"view {view.title!r}", name) for view in cls.views for name in view.metrics]
        for where, name in meant:
            if name not in names:
                raise PluginError(f"{cls.__name__}: {where} names {name!r}; declared are {', '.join(names)}")
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise PluginError(f"{cls.__name__}: metrics declares {', '.join(twice)} twice")

    @property
    def repeats(self) -> int:
        """How many cells this evaluator makes of each sequence and setting; each gets its `repeat`."""
        return 1

    @property
    def uses(self) -> tuple[PluginUse, ...]:
        """Other plugins that the result depends on."""
        return ()

    @property
    def requires(self) -> dict[str, Quantity]:
        """Parameters for which stands what another evaluator of the matrix measures, with the `quantity` of its metric.

        It is measured of the same codec setting on the same sequence. The cells are computed after those, their
        identity depends on the values, and these are kept with the record. `awaits` is its former name.
        """
        return getattr(self, "awaits", {})

    @property
    def counts_operations(self) -> bool:
        """Whether it runs the counting builds of the codec's kernels, so that these are compiled ahead too."""
        return False

    def repeat_identity(self, repeat: int) -> dict[str, Any]:
        """The parameters that determine one repeat; the engine leaves out those at their default.

        Override where a parameter lists the repeats, so that a longer list recomputes nothing.
        """
        return self.params.identity()

    def compare(self, outcome: Outcome, baseline: list[Outcome]) -> Iterator[Measurement]:
        """Measurements that need the baseline codec's outcomes on the same sequence; made when tables are built.

        They replace what `evaluate` measured of the same metric and stage.

        `baseline` is empty where the matrix has no baseline codec: yield NaN with that reason, or nothing.
        """
        return iter(())

    def drawing(self, outcome: Outcome) -> Drawing | None:
        """What a finished cell left, for a view of kind `map`; None where there is nothing to draw."""
        return None

    def marks(self, coded: CodedFrame) -> KeypointOverlay | None:
        """What to mark on a frame that is shown, by the definition that it measures; None where there is nothing."""
        return None


class FrameEvaluator(Evaluator[P]):
    """Looks at one frame at a time."""

    @abstractmethod
    def evaluate(self, coded: CodedFrame) -> Iterator[Measurement]:
        """Measurements of one frame; the engine fills in which frame it was."""


class SequenceEvaluator(Evaluator[P]):
    """Looks at a whole coded sequence in order."""

    @abstractmethod
    def evaluate(self, coded: CodedSequence, context: Context) -> Iterator[Measurement]:
        """Measurements of the sequence, or of its frames with `frame` set."""


class CodecEvaluator(Evaluator[P]):
    """Runs the codec itself; never sees cached bitstreams."""

    @abstractmethod
    def evaluate(self, codec: AnyCodec[Any], sequence: FrameSequence, context: Context) -> Iterator[Measurement]:
        """Measurements of the codec at work on the sequence; `codec` is a Codec, a StreamCodec or a FeatureCodec."""
