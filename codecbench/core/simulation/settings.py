"""The parameters that evaluators over a link share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, ValidationError, ValidatorFunctionWrapHandler, WrapValidator, model_validator
from pydantic_core import PydanticCustomError

from codecbench.core.contracts.evaluator import PluginSource, PluginUse
from codecbench.core.contracts.link import Link
from codecbench.core.contracts.metric import Quantity
from codecbench.core.contracts.params import Params

Transport = Literal["datagrams", "fec", "arq", "reliable"]
QueuePolicy = Literal["latest_only", "fifo", "drop_late", "auto"]
Time = Annotated[float, Field(ge=0.0)]


def _time_or_word(value: Any, handler: ValidatorFunctionWrapHandler) -> Any:
    """One sentence for what is neither."""
    try:
        return handler(value)
    except ValidationError:
        raise PydanticCustomError("time", "must be milliseconds, 0 or more, or `measured`") from None


MeasuredTime = Annotated[Time | Literal["measured"], WrapValidator(_time_or_word)]
"""Milliseconds, or `measured`: those that another evaluator of the matrix has measured of the same setting."""


class Adaptation(Params):
    """The parameter of a codec that a sender sets for each picture, and its range from the coarsest to the finest."""

    parameter: str
    range: tuple[int | float, int | float]


class LinkSettings(Params):
    """How pictures get from the camera to whoever reads them. docs/link.md explains each.

    link, link_params: the way; none where pictures are there at once. transport: what is done about lost packets.
    fec_share: redundant packets for each of data. mtu: bytes of a packet at most, of which header_bytes are headers.
    queue_policy: which pictures a sender keeps that has to wait; `auto`: all where they depend on each other, else the
    latest. deadline_ms: the age at which a picture is of no use.
    adapt: the parameter that the sender sets so that pictures fit what the link gives. concealed: whether pictures of a
    stream are handed on that depend on a lost one, as the decoder makes them up. partial: whether pictures that stand
    alone are handed on without their lost packets, by codecs that can decode the rest. encode_ms, decode_ms: what each
    picture takes; device_factor, receiver_factor: how many times slower the two machines are. link_seed: of all chance
    on the way.
    """

    times: ClassVar[Mapping[str, Quantity]] = {"encode_ms": "encoding", "decode_ms": "decoding"}
    """Parameters that may be `measured`, and what is measured then."""

    link: str | None = None
    link_params: dict[str, Any] = Field(default_factory=dict)
    transport: Transport = "datagrams"
    fec_share: Annotated[float, Field(gt=0.0, le=10.0)] = 0.2
    mtu: Annotated[int, Field(ge=32, le=65535)] = 1500
    header_bytes: Annotated[int, Field(ge=0)] = 40
    queue_policy: QueuePolicy = "latest_only"
    deadline_ms: Annotated[float, Field(gt=0.0)] | None = None
    adapt: Adaptation | None = None
    concealed: bool = False
    partial: bool = False
    encode_ms: MeasuredTime = 0.0
    decode_ms: MeasuredTime = 0.0
    device_factor: Annotated[float, Field(gt=0.0)] = 1.0
    receiver_factor: Annotated[float, Field(gt=0.0)] = 1.0
    link_seed: Annotated[int, Field(ge=0)] = 0

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        defaults = LinkSettings.model_construct()
        given = [name for name in LinkSettings.model_fields if getattr(self, name) != getattr(defaults, name)]
        if self.link is None and (given or type(self).model_fields["link"].default is not None):
            raise ValueError(f"{(given or ['this'])[0]} is about a link; name one, such as link: ideal")
        if self.header_bytes >= self.mtu:
            raise ValueError(f"header_bytes {self.header_bytes} leaves nothing of mtu {self.mtu}")
        if self.partial and self.is_repaired:
            raise ValueError(f"partial is for datagrams and fec; {self.transport} sends lost packets again")
        if self.queue_policy == "drop_late" and self.deadline_ms is None:
            raise ValueError("queue_policy drop_late needs deadline_ms: late for what?")
        return self

    @property
    def link_uses(self) -> tuple[PluginUse, ...]:
        """The link, as an evaluator declares it."""
        return () if self.link is None else (PluginUse("link", self.link, self.link_params),)

    def create_link(self, plugins: PluginSource) -> Link[Any]:
        """The link that `link_uses` declared."""
        assert self.link is not None
        link: Link[Any] = plugins.create("link", self.link, self.link_params)
        return link

    def link_rng(self, repeat: int) -> np.random.Generator:
        """All chance on the way in a repeat: the same for every codec."""
        return np.random.default_rng([self.link_seed, repeat])

    @property
    def payload_bytes(self) -> int:
        """Of a packet that is full."""
        return self.mtu - self.header_bytes

    @property
    def deadline_s(self) -> float:
        """Infinite where there is none."""
        return float("inf") if self.deadline_ms is None else 1e-3 * self.deadline_ms

    @property
    def requires(self) -> dict[str, Quantity]:
        """The parameters that are `measured`, as an evaluator declares them."""
        return {name: quantity for name, quantity in self.times.items() if getattr(self, name) == "measured"}

    def timed(self, inputs: Mapping[str, float]) -> Self:
        """The settings with what was measured."""
        return self.model_copy(update={name: inputs[name] for name in self.requires})

    @property
    def encode_s(self) -> float:
        """On the device."""
        return _seconds(self.encode_ms) * self.device_factor

    @property
    def decode_s(self) -> float:
        """At the receiver."""
        return _seconds(self.decode_ms) * self.receiver_factor

    @property
    def is_repaired(self) -> bool:
        """Whether the sender hears of lost packets and sends them again."""
        return self.transport in ("arq", "reliable")

    @property
    def is_paced(self) -> bool:
        """Whether the sender hands over only what the link's queue has room for."""
        return self.is_repaired or self.queue_policy != "fifo"


class ReaderSettings(LinkSettings):
    """How pictures get to a reader that takes `slam_ms` for each, and passes over those that come meanwhile."""

    times: ClassVar[Mapping[str, Quantity]] = {**LinkSettings.times, "slam_ms": "reading"}

    slam_ms: MeasuredTime = 0.0

    @model_validator(mode="after")
    def _reads_over_a_link(self) -> Self:
        if self.link is None and self.slam_ms:
            raise ValueError("slam_ms is about a link; name one, such as link: ideal")
        return self

    @property
    def read_s(self) -> float:
        """At the receiver."""
        return _seconds(self.slam_ms) * self.receiver_factor


def _seconds(time_ms: float | str) -> float:
    if isinstance(time_ms, str):
        raise TypeError(f"{time_ms!r} is no time yet; `timed` puts what was measured in its place")
    return 1e-3 * time_ms
