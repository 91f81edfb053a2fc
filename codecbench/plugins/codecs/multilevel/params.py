"""The multi-level codec's parameters."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from codecbench.core.contracts.params import Params
from codecbench.plugins.codecs.dct.planes import Color
from codecbench.plugins.codecs.multilevel.context.bitstream import CHROMA_UNITS, MAX_RESTART
from codecbench.plugins.codecs.multilevel.context.profile import Effort
from codecbench.plugins.codecs.multilevel.header import MAX_GROUP, MAX_LEVELS, MAX_QF, MIN_GROUP, MIN_QF
from codecbench.plugins.codecs.multilevel.keys import AutomaticKeys, Search
from codecbench.plugins.codecs.multilevel.levels import Scan

Fraction = Annotated[float, Field(gt=0, lt=1)]
Step = Annotated[int, Field(ge=1, le=65535)]

_CONTEXT_DEFAULTS = {"table": "flat", "color": "ycbcr420"}
_ONLY_STATIC = ("levels", "group", "keys", "seed", "decoding", "search", "scan")
_ONLY_CONTEXT = ("lapped", "chroma", "restart", "threads")


class MultilevelParams(Params):
    """Set how the multi-level codec quantizes, minimizes and decodes."""

    profile: Literal["static", "context"] = Field(
        "static", description="the paper's levels and tables, or binary decisions in adaptive contexts"
    )
    qf: float = Field(5.0, ge=MIN_QF, le=MAX_QF, description="factor on the quantization table")
    levels: int = Field(1, ge=1, le=MAX_LEVELS, description="levels of minimization")
    group: int = Field(3, ge=MIN_GROUP, le=MAX_GROUP, description="digits combined into one code")
    keys: AutomaticKeys | tuple[Fraction, ...] = Field(
        "canonical", description="canonical, random (by seed), or one key in (0, 1) for every digit of a group"
    )
    seed: int = Field(0, ge=0, description="seed of random keys")
    decoding: Literal["header", "search"] = Field(
        "header", description="send the tuples of the tables, or their codes and the keys to search them"
    )
    search: Search = Field("greedy", description="search method of this decoder; all find the same tuples")
    color: Color = Field("rgb", description="planes of a color image; a gray image is always one plane")
    scan: Scan = Field("block", description="coefficients block by block, or frequency by frequency")
    table: Literal["paper", "standard", "flat"] | tuple[Step, ...] = Field(
        "paper", description="quantization table, or its 64 steps row by row"
    )

    effort: Effort = Field(
        "best",
        description="context: no mixing, mixing, or also indices chosen by cost; static: fast or best tables",
    )
    lapped: bool = Field(False, description="context: filter across the borders between blocks")
    chroma: float = Field(
        1.5,
        ge=1 / CHROMA_UNITS,
        le=255 / CHROMA_UNITS,
        description="context: factor on the quantization steps of planes after the first",
    )
    restart: int = Field(
        0, ge=0, le=MAX_RESTART, description="context: rows of 16 pixels from one restart point to the next, 0 for none"
    )
    threads: int = Field(
        1,
        ge=1,
        le=64,
        description="context: slices between restart points that are coded in parallel; the bytes stay the same",
    )

    @model_validator(mode="before")
    @classmethod
    def _defaults_of_profile(cls, values: Any) -> Any:
        """The profile `context` has other defaults for two parameters."""
        if isinstance(values, dict) and values.get("profile") == "context":
            return {**_CONTEXT_DEFAULTS, **values}
        return values

    @model_validator(mode="after")
    def _check_profile(self) -> Self:
        names = _ONLY_CONTEXT if self.profile == "static" else _ONLY_STATIC
        for name in names:
            if getattr(self, name) != type(self).model_fields[name].default:
                raise ValueError(f"{name}: the profile {self.profile} does not support it; leave it out")
        return self

    @model_validator(mode="after")
    def _check_threads(self) -> Self:
        if self.threads > 1 and not self.restart:
            raise ValueError("threads: they share the slices between restart points; set restart too")
        return self

    @model_validator(mode="after")
    def _check_effort(self) -> Self:
        """Of the profile `static`, `fast` is for tables that are sent as tuples, which ascend under their keys."""
        if self.profile == "context" or self.effort == "best":
            return self
        if self.effort == "normal":
            raise ValueError("effort: the profile static has no normal; set fast or best")
        if self.decoding == "search" or not isinstance(self.keys, str):
            raise ValueError("effort: fast needs tuples in the header and keys in order; leave out decoding and keys")
        return self

    @model_validator(mode="after")
    def _check_lengths(self) -> Self:
        if not isinstance(self.keys, str) and len(self.keys) != self.group:
            raise ValueError(f"keys: {len(self.keys)} keys for groups of {self.group} digits; give one key per digit")
        if not isinstance(self.table, str) and len(self.table) != 64:
            raise ValueError(f"table: {len(self.table)} steps; give 64, row by row")
        return self
