"""The evaluator contract: what is measured, on what, and how it is declared.

A FrameEvaluator gets one coded frame at a time, a SequenceEvaluator the whole coded sequence in order. A CodecEvaluator
gets the codec itself, to time or trace it. All yield Measurements of the metrics that the class declares; an undeclared
one fails the cell.
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
from codecbench.core.contracts.errors import PluginError, former_names
from codecbench.core.contracts.features import Features
from codecbench.core.contracts.hooks import Kind
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.metric import Metric, Quantity
from codecbench.core.contracts.params import Configured, P
from codecbench.core.contracts.sequence import Frame, FrameSequence
from codecbench.core.contracts.stream import Packet
from codecbench.core.contracts.view import Drawing, KeypointOverlay, View


@dataclass(frozen=True)
class Measurement:
    """One value of one metric."""

    metric: str
    """Name of a metric that the evaluator declares."""
    value: float
    """In the metric's unit. It may be infinite (identical images); NaN is a missing value and needs a `reason`."""
    frame: int | None = None
    """Index of its frame in the sequence; None for a value of the whole sequence."""
    stage: str | None = None
    """`encode` or `decode`, or a part of one, such as `encode/dct`; None if it belongs to no stage."""
    reason: str | None = None
    """Why the value is missing."""


@dataclass(frozen=True)
class CodedFrame:
    """A frame, its bitstream and the decoded image."""

    original: Frame
    bitstream: bytes = field(repr=False)
    decoded: Image = field(repr=False)

    @cached_property
    def size_bytes(self) -> int:
        """Size of the bitstream in bytes."""
        return len(self.bitstream)


@dataclass(frozen=True)
class SentPacket:
    """A packet of a coded sequence, without its bytes."""

    frame: int
    """Index of its frame in the sequence."""
    size_bytes: int
    starts: bool
    """Whether it is a keyframe: decoding can start at it (random access)."""
    after: int
    """How many frames the encoder had been given when the packet came out: `frame + 1` without delay."""
    recovery_frames: int | None = None
    """As in `Packet`."""
    session: int = 0
    """Number of its encoding session, from 0; a sender that adapts opens several."""

    def packet(self, data: bytes) -> Packet:
        """Return the packet with its bytes, as a decoder gets it."""
        return Packet(data, self.frame, self.starts, self.recovery_frames)


class FrameSender(Protocol):
    """Codes chosen frames of a sequence, in rising order."""

    def send(self, index: int) -> CodedFrame:
        """Code the frame after those sent before; a frame that was sent already is returned, not sent twice.

        Raises Unsupported if an inter-frame codec holds the frame back, or has sent a later one.
        """
        ...


class CodedSequence(Protocol):
    """All frames of a sequence under one codec setting; frames are read and decoded on demand."""

    @property
    def sequence(self) -> FrameSequence: ...

    @property
    def codec(self) -> AnyCodec[Any]: ...

    @property
    def packets(self) -> tuple[SentPacket, ...]:
        """The packets in sending order."""
        ...

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[CodedFrame]: ...

    def frame(self, index: int) -> CodedFrame:
        """Return one coded frame. Raises Unsupported for a feature codec, as iterating does."""
        ...

    def features(self, index: int) -> Features:
        """Return a frame's decoded features. Raises Unsupported for any codec but a feature codec."""
        ...

    def size_bytes(self, index: int) -> int:
        """Return the size of one frame's bitstream in bytes, without decoding it."""
        ...

    def sender(self) -> FrameSender:
        """Return a sender of chosen frames only; with an inter-frame codec they make a stream of their own.

        Raises Unsupported for a feature codec.
        """
        ...


@dataclass(frozen=True)
class PluginUse:
    """Another plugin that an evaluator runs; its version becomes part of the cell's identity."""

    kind: Kind
    name: str
    params: dict[str, Any] = field(default_factory=dict)


class PluginSource(Protocol):
    """Creates the plugins that an evaluator declared in `uses`."""

    def create(self, kind: Kind, name: str, params: dict[str, Any]) -> Any:
        """Create a plugin of this kind and name with these parameters."""


@former_names(awaited="inputs")
@dataclass(frozen=True)
class Context:
    """What the engine gives a cell: random numbers, a folder, plugins and inputs."""

    rng: np.random.Generator
    """Random numbers, seeded from the cell's identity."""
    repeat: int
    """Number of the repeat, from 0."""
    artifacts: Path
    """An existing folder; files written there are stored beside the record."""
    plugins: PluginSource
    """Creates the plugins that the evaluator declared in `uses`."""
    inputs: Mapping[str, float] = field(default_factory=dict)
    """For each parameter declared in `requires`, the median of the measured values."""


@dataclass(frozen=True)
class Outcome:
    """A finished cell, as another one sees it."""

    repeat: int
    """Number of the repeat, from 0."""
    measurements: tuple[Measurement, ...]
    artifacts: Path
    """Folder of the files that it wrote."""

    def value(self, metric: str) -> float:
        """Return the value of a metric that is measured once; NaN if it is missing."""
        return next((m.value for m in self.measurements if m.metric == metric), float("nan"))


class Evaluator(Configured[P]):
    """Base of the three kinds of evaluator; subclass one of those."""

    metrics: ClassVar[tuple[Metric, ...]]
    """All metrics that `evaluate` and `compare` may yield."""
    views: ClassVar[tuple[View, ...]] = ()
    """Charts that it offers beyond those that the metrics' roles imply."""
    needs: ClassVar[frozenset[Literal["camera", "ground_truth", "depth"]]] = frozenset()
    """What the sequence must have; `depth`: its pixels are distances."""
    bits: ClassVar[tuple[int, ...]] = (8,)
    """Bits of the samples of frames that it understands; on others its cells are `unsupported`."""
    exclusive: ClassVar[bool] = False
    """Nothing else may run on the machine meanwhile."""
    kernels: ClassVar[tuple[str, ...]] = ()
    """Packages and modules whose kernels a run compiles ahead."""
    typical_ms_per_frame: ClassVar[float | None] = None
    """Time of a cell for each 640x480 RGB frame, decoding included, for estimates before anything is measured.

    None for evaluators that look at a few frames, however long the sequence."""

    def __init_subclass__(cls, **options: Any) -> None:
        """Raise PluginError if metrics or views name an undeclared metric, or a metric is declared twice."""
        super().__init_subclass__(**options)
        names = [metric.name for metric in getattr(cls, "metrics", ())]
        references = [(f"metric {metric.name!r}", other) for metric in getattr(cls, "metrics", ())
                      for other in (metric.confirmed_by, metric.in_units_of, metric.shown_with) if other]  # fmt: skip
        references += [(f"view {view.title!r}", name) for view in cls.views for name in view.metrics]
        for where, name in references:
            if name not in names:
                raise PluginError(f"{cls.__name__}: {where} names {name!r}; declared are {', '.join(names)}")
        if duplicates := sorted({name for name in names if names.count(name) > 1}):
            raise PluginError(f"{cls.__name__}: metrics declares {', '.join(duplicates)} twice")

    @property
    def repeats(self) -> int:
        """Number of cells for each sequence and setting; each gets its `repeat`."""
        return 1

    @property
    def uses(self) -> tuple[PluginUse, ...]:
        """Other plugins that the result depends on."""
        return ()

    @property
    def requires(self) -> dict[str, Quantity]:
        """Parameters whose values another evaluator of the experiment measures, each with its metric's `quantity`.

        The values are measured on the same codec setting and sequence. These cells are computed after those, their
        identity depends on the values, and the record stores them. `awaits` is the deprecated name.
        """
        return getattr(self, "awaits", {})

    @property
    def counts_operations(self) -> bool:
        """Whether it runs the counting builds of the codec's kernels, so that a run compiles these ahead too."""
        return False

    def repeat_identity(self, repeat: int) -> dict[str, Any]:
        """Return the parameters that determine one repeat; the engine leaves out those at their default.

        Override it if a parameter lists the repeats, so that a longer list recomputes nothing.
        """
        return self.params.identity()

    def compare(self, outcome: Outcome, baseline: list[Outcome]) -> Iterator[Measurement]:
        """Yield measurements that need the baseline codec's outcomes on the same sequence, when tables are built.

        They replace those that `evaluate` yielded of the same metric and stage. `baseline` is empty if the experiment
        has no baseline codec: yield NaN with that reason, or nothing.
        """
        return iter(())

    def drawing(self, outcome: Outcome) -> Drawing | None:
        """Return the drawing of a finished cell, for a view of kind `map`; None if there is none."""
        return None

    def marks(self, coded: CodedFrame) -> KeypointOverlay | None:
        """Return the keypoints to mark on a displayed frame, defined as in the measurement; None if there are none."""
        return None


class FrameEvaluator(Evaluator[P]):
    """Measures one frame at a time."""

    @abstractmethod
    def evaluate(self, coded: CodedFrame) -> Iterator[Measurement]:
        """Yield measurements of one frame; the engine sets their `frame`."""


class SequenceEvaluator(Evaluator[P]):
    """Measures a whole coded sequence in order."""

    @abstractmethod
    def evaluate(self, coded: CodedSequence, context: Context) -> Iterator[Measurement]:
        """Yield measurements of the sequence, or of single frames with `frame` set."""


class CodecEvaluator(Evaluator[P]):
    """Runs the codec itself; never gets cached bitstreams."""

    @abstractmethod
    def evaluate(self, codec: AnyCodec[Any], sequence: FrameSequence, context: Context) -> Iterator[Measurement]:
        """Yield measurements of the codec at work; `codec` is a Codec, a StreamCodec or a FeatureCodec."""
