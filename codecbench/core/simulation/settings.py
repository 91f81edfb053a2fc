"""The parameters that evaluators over a link share."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from codecbench.core.contracts.evaluator import PluginSource, PluginUse
from codecbench.core.contracts.link import Link
from codecbench.core.contracts.params import Params

Transport = Literal["datagrams", "fec", "arq", "reliable"]
QueuePolicy = Literal["latest_only", "fifo", "drop_late", "auto"]
Time = Annotated[float, Field(ge=0.0)]


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
    picture takes; device_factor: how much slower the device encodes. link_seed: of all chance on the way.
    """

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
    encode_ms: Time = 0.0
    decode_ms: Time = 0.0
    device_factor: Annotated[float, Field(gt=0.0)] = 1.0
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
    def encode_s(self) -> float:
        """On the device."""
        return 1e-3 * self.encode_ms * self.device_factor

    @property
    def is_repaired(self) -> bool:
        """Whether the sender hears of lost packets and sends them again."""
        return self.transport in ("arq", "reliable")

    @property
    def is_paced(self) -> bool:
        """Whether the sender hands over only what the link's queue has room for."""
        return self.is_repaired or self.queue_policy != "fifo"
