"""Settings of the `trajectory` evaluator."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from codecbench.core.simulation.settings import ReaderSettings

Count = Annotated[int, Field(ge=0)]


class TrajectoryParams(ReaderSettings):
    """Set the SLAM backend, its input and repeats, and the limits of a success.

    backend, backend_params: the SLAM backend and its parameters. architecture: `cta` (compress then analyze: all of
    SLAM sees decoded frames, or the features that a feature codec sends), `atc` (analyze then compress, as in the
    paper: tracking sees raw frames; mapping and loop closing see decoded keyframes) or `features` (as `cta`, but
    refuses image codecs). start_offsets, seeds: one repeat for each pair; an offset is how many frames are omitted at
    the start. association_s: largest time between a frame and its ground truth, in seconds. rpe_interval_s: interval of
    relative errors, in seconds. The parameters about a link are those of ReaderSettings: SLAM gets delivered frames
    only, and needs slam_ms for each.

    Limits of a success; they can change without new runs. tracked_to_raw: least tracked share, as a multiple of raw's.
    ate_to_raw: largest ATE, as a multiple of raw's. ate_limit_m: largest ATE in metres, instead of that multiple.
    raw_agrees_percent: without ground truth, raw's paths replace it if they differ by at most this percentage of their
    length. delay_frames: most frames by which the first map may come later than in the raw run.
    """

    backend: str = "orb"
    backend_params: dict[str, Any] = Field(default_factory=dict)
    architecture: Literal["cta", "atc", "features"] = "cta"
    start_offsets: Annotated[tuple[Count, ...], Field(min_length=1)] = (0,)
    seeds: Annotated[tuple[Count, ...], Field(min_length=1)] = (0,)
    association_s: Annotated[float, Field(gt=0.0, le=1.0)] = 0.02
    rpe_interval_s: Annotated[float, Field(gt=0.0)] = 1.0
    tracked_to_raw: Annotated[float, Field(gt=0.0, le=1.0)] = 0.9
    ate_to_raw: Annotated[float, Field(ge=1.0)] = 2.0
    ate_limit_m: Annotated[float, Field(gt=0.0)] | None = None
    raw_agrees_percent: Annotated[float, Field(gt=0.0)] = 5.0
    delay_frames: Count = 30

    @field_validator("start_offsets", "seeds")
    @classmethod
    def _distinct(cls, values: tuple[int, ...]) -> tuple[int, ...]:
        if len(set(values)) < len(values):
            raise ValueError(f"{list(values)} has a value twice; each repeat must be a different run")
        return values

    @model_validator(mode="after")
    def _fits_a_link(self) -> Self:
        if self.link is not None and self.architecture == "atc":
            raise ValueError("architecture atc over a link is not simulated; use cta")
        return self

    def repeat(self, number: int) -> tuple[int, int]:
        """Start offset and seed of a repeat: all offsets with the first seed, then with the next."""
        seed, offset = divmod(number, len(self.start_offsets))
        return self.start_offsets[offset], self.seeds[seed]
