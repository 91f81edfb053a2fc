"""Settings of the `trajectory` evaluator."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from codecbench.core.simulation.settings import ReaderSettings

Count = Annotated[int, Field(ge=0)]


class TrajectoryParams(ReaderSettings):
    """Settings of `trajectory`.

    backend, backend_params: the SLAM backend that runs. architecture: `cta` (compress then analyze: all of SLAM sees
    what comes of the codec: decoded frames, or features of a codec of features), `atc` (analyze then compress, as the
    paper has it: tracking sees raw frames; mapping and loop closing see decoded keyframes) or `features` (as `cta`, and
    codecs of pictures are refused). start_offsets, seeds: one repeat for each pair, with so many frames left out at
    the start. association_s: how far apart in time a frame and its ground truth may be. rpe_interval_s: over which
    relative errors are taken. link and all about it: see ReaderSettings; SLAM then gets what is delivered, and slam_ms
    is what it takes for a frame.

    What a success is can be changed without computing anything again. tracked_to_raw: the least share of the raw runs'
    tracked share. ate_to_raw: the most times their error. ate_limit_m: an error in place of that multiple.
    raw_agrees_percent: without ground truth raw's paths stand in for it, if they are at most so far apart, in percent
    of their length. delay_frames: how many frames later than the raw run's the first map may come.
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
            raise ValueError(f"{list(values)} names a value twice; every repeat is another run")
        return values

    @model_validator(mode="after")
    def _fits_a_link(self) -> Self:
        if self.link is not None and self.architecture == "atc":
            raise ValueError("architecture atc over a link is not simulated; give cta")
        return self

    def repeat(self, number: int) -> tuple[int, int]:
        """Start offset and seed of a repeat: all offsets with the first seed, then with the next."""
        seed, offset = divmod(number, len(self.start_offsets))
        return self.start_offsets[offset], self.seeds[seed]
