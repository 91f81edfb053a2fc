"""The `operations` evaluator counts operations in three families, which share their classes and are never mixed.

`source`: operations in the source of the codec's kernels, only for codecs that run all their arithmetic in kernels.
`model`: the paper's closed formulas for the frame's size. `machine`: executed instructions, classified one by one.
A family that a codec does not have is missing, never zero.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, Field

from codecbench.core.contracts.codec import AnyCodec
from codecbench.core.contracts.errors import Unsupported
from codecbench.core.contracts.evaluator import CodecEvaluator, Context, Measurement
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.metric import Metric
from codecbench.core.contracts.params import Params
from codecbench.core.contracts.sequence import FrameSequence
from codecbench.core.contracts.view import View
from codecbench.core.counting.operations import CLASSES, COUNTERS, OperationCounts
from codecbench.core.counting.trace import CountingTrace
from codecbench.plugins.evaluators.operations import machine, model
from codecbench.plugins.evaluators.operations.model import PAPER_NONZERO_SHARE, Plane, Stages
from codecbench.plugins.evaluators.sampling import evenly_spread

_COUNTING_DIFFERS = "{}: the counting build gives other results than the fast build"
Family = Literal["source", "model", "machine"]
_FAMILIES: tuple[Family, ...] = ("source", "model", "machine")

_SUMMARIES = {
    "mults": "multiplications, divisions, remainders, square roots, elementary functions",
    "adds": "additions, subtractions, negations, absolute values, roundings",
    "bit_ops": "integer and, or, exclusive or, inversion",
    "comparisons": "comparisons, also in min, max and conditions",
    "shifts": "shifts by any amount",
    "reads": "array loads (machine: memory operands read, stack included)",
    "writes": "array stores (machine: memory operands written)",
    "total": "the seven classes together",
    "divisions": "divisions among the multiplications",
    "index_ops": "arithmetic in brackets, range bounds and array sizes, two per for-loop turn; in no total",
}
_LABELS = {
    "mults": "multiplications", "adds": "additions", "bit_ops": "bitwise operations", "total": "operations",
    "index_ops": "index arithmetic",
}  # fmt: skip
_EXTRA_COUNTERS = {"source": COUNTERS[len(CLASSES) :], "model": (), "machine": ("divisions",)}


def _names(family: Family) -> tuple[str, ...]:
    return (*CLASSES, "total", *_EXTRA_COUNTERS[family])


def _sort_families(families: tuple[Family, ...]) -> tuple[Family, ...]:
    if not families:
        raise ValueError(f"give at least one of {', '.join(_FAMILIES)}")
    return tuple(family for family in _FAMILIES if family in families)


class OperationsParams(Params):
    """Set which operations are counted, and on how many frames.

    families: the counts to make. frames: how many frames, spread evenly over the sequence.
    planes: for the model, `paper` counts one plane of any image, as the paper does, and `all` every coded plane.
    nonzero_share: for the model of JPEG, the share of nonzero coefficients: the paper's 0.2, or measured on the frame.
    """

    families: Annotated[tuple[Family, ...], AfterValidator(_sort_families)] = ("source", "model")
    frames: Annotated[int, Field(ge=1)] = 1
    planes: Literal["paper", "all"] = "paper"
    nonzero_share: Literal["paper", "measured"] = "paper"


def _metric(family: Family, name: str) -> Metric:
    is_headline = (family, name) == ("source", "total")
    return Metric(
        f"{family}_{name}", "ops", "lower", f"{_SUMMARIES[name]}, {family} counts", repeatable=family != "machine",
        role="operations", headline=is_headline, label=f"{_LABELS.get(name, name)}, {family}",
        column_header="Mops" if is_headline else "", scale="log", display_unit="Mops", display_factor=1e-6,
    )  # fmt: skip


class Operations(CodecEvaluator[OperationsParams]):
    """Operations per frame, by stage (`encode/dct`), with the totals of `encode` and `decode`."""

    name = "operations"
    version = "2"
    bits = (8, 16)
    params_type = OperationsParams
    metrics: ClassVar[tuple[Metric, ...]] = tuple(
        _metric(family, name) for family in _FAMILIES for name in _names(family)
    )
    views = (
        View(
            "bars",
            "Operations per frame, by stage",
            tuple(f"{family}_total" for family in _FAMILIES),
            "Operations are counted in the kernels (source), by the paper's formulas (model) or as executed "
            "instructions (machine); the three are never added. Source counts of codecs in foreign libraries are "
            "missing, not zero.",
        ),
    )

    @property
    def counts_operations(self) -> bool:
        return "source" in self.params.families

    def evaluate(self, codec: AnyCodec[Any], sequence: FrameSequence, context: Context) -> Iterator[Measurement]:
        if not codec.stateless:
            raise Unsupported(f"{codec.name} is opaque: it has memory, so the cost of a frame depends on earlier ones")
        families = self._available(codec)
        for index in evenly_spread(len(sequence), self.params.frames):
            image = sequence.read(index).image
            for family in families:
                for stage, counts in self._count(family, codec, image).items():
                    yield from _measurements(family, counts, index, stage)
        if "machine" in self.params.families and (reason := machine.reason_unavailable()):
            for direction in ("encode", "decode"):
                for name in _names("machine"):
                    yield Measurement(f"machine_{name}", math.nan, stage=direction, reason=reason)

    def _available(self, codec: AnyCodec[Any]) -> list[Family]:
        """The requested families that this codec has here. Raises Unsupported, with reasons, if there are none."""
        reasons: dict[Family, str | None] = {
            "source": None
            if codec.capabilities.counts_operations
            else f"{codec.name} is opaque: it has no kernels to count",
            "model": None if self._has_model(codec) else f"the paper has no model of {codec.name} with this setting",
            "machine": machine.reason_unavailable(),
        }
        available = [family for family in self.params.families if reasons[family] is None]
        if not available:
            raise Unsupported("; ".join(reasons[family] or "" for family in self.params.families))
        return available

    def _has_model(self, codec: AnyCodec[Any]) -> bool:
        return model.has_model(codec.name, codec.params.model_dump())

    def _count(self, family: Family, codec: AnyCodec[Any], image: Image) -> dict[str, OperationCounts]:
        if family == "source":
            return _add_totals(*source_counts(codec, image))
        if family == "model":
            return _add_totals(*self._model_stages(codec, image))
        counts: dict[str, OperationCounts] = codec.at_encoder(machine.count_executed, image)
        return counts

    def _model_stages(self, codec: AnyCodec[Any], image: Image) -> tuple[Stages, Stages]:
        values = codec.params.model_dump()
        height, width = image.shape[:2]
        all_planes = self.params.planes == "all"
        planes = model.coded_planes(image, values) if all_planes else [Plane(width, height)]
        share = PAPER_NONZERO_SHARE
        if self.params.nonzero_share == "measured" and codec.name.startswith("jpeg") and codec.name != "jpeg2000":
            share = model.measure_nonzero_share(image, codec.encode(image))
        return model.model_stages(codec.name, values, planes, share)


def source_counts(codec: AnyCodec[Any], image: Image) -> tuple[Stages, Stages]:
    """Operations of the codec's kernels to encode and to decode an image, by stage.

    Raises RuntimeError if counting changes the bitstream or the decoded image.
    """
    bitstream, encoding = codec.at_encoder(count_encoding, image)
    return encoding, codec.at_decoder(count_decoding, bitstream)


def count_encoding(codec: AnyCodec[Any], image: Image) -> tuple[bytes, Stages]:
    """The bitstream of an image, and the operations of encoding it, by stage."""
    trace, prepared = CountingTrace(), codec.prepared(image)
    bitstream = prepared.encode(image, trace=trace)
    if bitstream != prepared.encode(image):
        raise RuntimeError(_COUNTING_DIFFERS.format(codec.name))
    return bitstream, trace.counts


def count_decoding(codec: AnyCodec[Any], bitstream: bytes) -> Stages:
    """The operations of decoding, by stage."""
    trace = CountingTrace()
    if not np.array_equal(codec.decode(bitstream, trace=trace), codec.decode(bitstream)):
        raise RuntimeError(_COUNTING_DIFFERS.format(codec.name))
    return trace.counts


def _add_totals(encoding: Stages, decoding: Stages) -> Stages:
    """All stages as `encode/...` and `decode/...`, with the totals `encode` and `decode`."""
    stages: Stages = {}
    for direction, parts in (("encode", encoding), ("decode", decoding)):
        stages |= {f"{direction}/{name}": counts for name, counts in parts.items()}
        stages[direction] = OperationCounts.sum(parts.values())
    return stages


def _measurements(family: Family, counts: OperationCounts, frame: int, stage: str) -> Iterator[Measurement]:
    for name in _names(family):
        yield Measurement(f"{family}_{name}", float(getattr(counts, name)), frame, stage)
