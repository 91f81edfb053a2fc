"""Settings of the `trajectory` evaluator."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, field_validator

from codecbench.core.contracts.params import Params

Count = Annotated[int, Field(ge=0)]


class TrajectoryParams(Params):
    """Settings of `trajectory`.

    backend, backend_params: the SLAM backend that runs. architecture: `cta` (compress then analyze: all of SLAM sees
    decoded frames) or `atc` (analyze then compress: tracking sees raw frames; mapping and loop closing see decoded
    keyframes). start_offsets, seeds: one repeat for each pair, with so many frames left out at the start.
    association_s: how far apart in time a frame and its ground truth may be. rpe_interval_s: over which relative
    errors are taken. ate_limit_m: an error up to which a run is a success, in place of a multiple of the raw run's.
    """

    backend: str = "orb"
    backend_params: dict[str, Any] = Field(default_factory=dict)
    architecture: Literal["cta", "atc"] = "cta"
    start_offsets: Annotated[tuple[Count, ...], Field(min_length=1)] = (0,)
    seeds: Annotated[tuple[Count, ...], Field(min_length=1)] = (0,)
    association_s: Annotated[float, Field(gt=0.0, le=1.0)] = 0.02
    rpe_interval_s: Annotated[float, Field(gt=0.0)] = 1.0
    ate_limit_m: Annotated[float, Field(gt=0.0)] | None = None

    @field_validator("start_offsets", "seeds")
    @classmethod
    def _distinct(cls, values: tuple[int, ...]) -> tuple[int, ...]:
        if len(set(values)) < len(values):
            raise ValueError(f"{list(values)} names a value twice; every repeat is another run")
        return values

    def repeat(self, number: int) -> tuple[int, int]:
        """Start offset and seed of a repeat: all offsets with the first seed, then with the next."""
        seed, offset = divmod(number, len(self.start_offsets))
        return self.start_offsets[offset], self.seeds[seed]
