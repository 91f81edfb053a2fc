"""An evaluator: how many edges of each frame survive coding."""

from collections.abc import Iterator

import cv2
import numpy as np
from pydantic import Field

from codecbench import (
    CodedSequence,
    Context,
    Drawing,
    Image,
    Line,
    Measurement,
    Metric,
    Outcome,
    Params,
    SequenceEvaluator,
    View,
    gray_from_image,
)

_PROFILE = "profile.csv"


class EdgesParams(Params):
    least_kept: float = Field(default=0.8, gt=0, le=1, description="share of edges that a run must keep to succeed")


class Edges(SequenceEvaluator[EdgesParams]):
    name = "edges"
    version = "1"
    params_type = EdgesParams
    metrics = (
        Metric("edges_kept", "1", "higher", "share of edge pixels that survive", role="task", headline=True),
        Metric("edges_made", "1", "lower", "edge pixels that were none, as a share of those that were", role="task"),
        Metric("edges_hold", "1", "higher", "1 where enough edges are kept, else 0", role="success", headline=True),
    )
    views = (
        View("curve", "Edges made and kept", ("edges_made", "edges_kept")),
        View("map", "Edges along the picture", note="Edge pixels in each column of the first frame."),
    )

    def evaluate(self, coded: CodedSequence, context: Context) -> Iterator[Measurement]:
        kept = []
        for position, frame in enumerate(coded):
            before, after = _edges(frame.original.image), _edges(frame.decoded)
            if position == 0:
                np.savetxt(context.artifacts / _PROFILE, [before.sum(axis=0), after.sum(axis=0)], delimiter=",")
            count = int(before.sum())
            if count == 0:
                yield Measurement("edges_kept", float("nan"), position, reason="the original frame has no edge")
                continue
            kept.append((before & after).sum() / count)
            yield Measurement("edges_kept", float(kept[-1]), position)
            yield Measurement("edges_made", float((after & ~before).sum() / count), position)
        if kept:
            yield Measurement("edges_hold", float(np.mean(kept) >= self.params.least_kept))

    def drawing(self, outcome: Outcome) -> Drawing:
        before, after = np.loadtxt(outcome.artifacts / _PROFILE, delimiter=",")
        columns = np.arange(len(before))
        lines = (
            Line("original", "truth", np.column_stack([columns, before])),
            Line("decoded", "after", np.column_stack([columns, after])),
        )
        return Drawing(
            lines, f"{after.sum():.0f} edge pixels of {before.sum():.0f}", outcome.value("edges_hold") == 1.0
        )


def _edges(image: Image) -> np.ndarray:
    return cv2.Canny(gray_from_image(image), 60, 120) > 0
