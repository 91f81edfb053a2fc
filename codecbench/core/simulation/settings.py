"""Parameters that evaluators over a link share."""

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
    """Raise one error, in one sentence, for what is neither."""
    try:
        return handler(value)
    except ValidationError:
        raise PydanticCustomError("time", "must be milliseconds, 0 or more, or `measured`") from None


MeasuredTime = Annotated[Time | Literal["measured"], WrapValidator(_time_or_word)]
"""Milliseconds, or `measured`: as another evaluator of the experiment measures them of the same setting."""


class Adaptation(Params):
    """The codec parameter that the sender sets for each frame, and its range."""

    parameter: str
    """Name of the codec's parameter."""
    range: tuple[int | float, int | float]
    """Its coarsest and its finest value."""


class LinkSettings(Params):
    """Describes how frames get from the camera to the reader; see docs/link.md."""

    times: ClassVar[Mapping[str, Quantity]] = {"encode_ms": "encoding", "decode_ms": "decoding"}
    """Parameters that may be `measured`, with the quantity that is measured then."""

    link: str | None = None
    """Name of a link plugin; None for no link: frames arrive at once."""
    link_params: dict[str, Any] = Field(default_factory=dict)
    """Parameters of the link plugin."""
    transport: Transport = "datagrams"
    """How lost packets are handled."""
    fec_share: Annotated[float, Field(gt=0.0, le=10.0)] = 0.2
    """Redundant packets for each data packet, with the transport `fec`."""
    mtu: Annotated[int, Field(ge=32, le=65535)] = 1500
    """Largest packet in bytes, headers included."""
    header_bytes: Annotated[int, Field(ge=0)] = 40
    """Header bytes of each packet."""
    queue_policy: QueuePolicy = "latest_only"
    """Which waiting frames a sender drops; `auto`: none of an inter-frame codec, else all but the latest."""
    deadline_ms: Annotated[float, Field(gt=0.0)] | None = None
    """Age in milliseconds beyond which a frame is useless; None for no deadline."""
    adapt: Adaptation | None = None
    """The codec parameter that the sender sets so that frames fit the link's throughput; None for none."""
    concealed: bool = False
    """Whether frames that depend on a lost one are output as the decoder conceals them."""
    partial: bool = False
    """Whether intra-coded frames are output without their lost packets, by codecs that decode the rest."""
    encode_ms: MeasuredTime = 0.0
    """Encoding time of a frame in milliseconds; 0 for none."""
    decode_ms: MeasuredTime = 0.0
    """Decoding time of a frame in milliseconds; 0 for none."""
    device_factor: Annotated[float, Field(gt=0.0)] = 1.0
    """How many times slower the encoding device is than the one timed."""
    receiver_factor: Annotated[float, Field(gt=0.0)] = 1.0
    """How many times slower the receiver is than the machine timed."""
    link_seed: Annotated[int, Field(ge=0)] = 0
    """Seed of all randomness on the link."""

    @model_validator(mode="after")
    def _check_consistency(self) -> Self:
        defaults = LinkSettings.model_construct()
        changed = [name for name in LinkSettings.model_fields if getattr(self, name) != getattr(defaults, name)]
        if self.link is None and (changed or type(self).model_fields["link"].default is not None):
            raise ValueError(f"{(changed or ['this'])[0]} needs a link; set one, such as link: ideal")
        if self.header_bytes >= self.mtu:
            raise ValueError(f"header_bytes {self.header_bytes} must be less than mtu {self.mtu}")
        if self.partial and self.is_repaired:
            raise ValueError(f"partial needs transport datagrams or fec; {self.transport} retransmits lost packets")
        if self.queue_policy == "drop_late" and self.deadline_ms is None:
            raise ValueError("queue_policy drop_late needs deadline_ms")
        return self

    @property
    def link_uses(self) -> tuple[PluginUse, ...]:
        """The link, for an evaluator's `uses`."""
        return () if self.link is None else (PluginUse("link", self.link, self.link_params),)

    def create_link(self, plugins: PluginSource) -> Link[Any]:
        """Create the link that `link_uses` declares."""
        assert self.link is not None
        link: Link[Any] = plugins.create("link", self.link, self.link_params)
        return link

    def link_rng(self, repeat: int) -> np.random.Generator:
        """Return the random generator of a repeat's link, equal for every codec."""
        return np.random.default_rng([self.link_seed, repeat])

    @property
    def payload_bytes(self) -> int:
        """Payload of a full packet."""
        return self.mtu - self.header_bytes

    @property
    def deadline_s(self) -> float:
        """Deadline in seconds; infinite if there is none."""
        return float("inf") if self.deadline_ms is None else 1e-3 * self.deadline_ms

    @property
    def requires(self) -> dict[str, Quantity]:
        """The parameters that are `measured`, for an evaluator's `requires`."""
        return {name: quantity for name, quantity in self.times.items() if getattr(self, name) == "measured"}

    def with_measured_times(self, inputs: Mapping[str, float]) -> Self:
        """Return the settings with the measured times in place of `measured`."""
        return self.model_copy(update={name: inputs[name] for name in self.requires})

    @property
    def encode_s(self) -> float:
        """Encoding time of a frame on the device, in seconds."""
        return _seconds(self.encode_ms) * self.device_factor

    @property
    def decode_s(self) -> float:
        """Decoding time of a frame at the receiver, in seconds."""
        return _seconds(self.decode_ms) * self.receiver_factor

    @property
    def is_repaired(self) -> bool:
        """Whether lost packets are retransmitted."""
        return self.transport in ("arq", "reliable")

    @property
    def is_paced(self) -> bool:
        """Whether the sender passes on only as many packets as fit into the link's queue."""
        return self.is_repaired or self.queue_policy != "fifo"


class ReaderSettings(LinkSettings):
    """Describes how frames get to a reader that spends `slam_ms` on each and skips those that arrive meanwhile."""

    times: ClassVar[Mapping[str, Quantity]] = {**LinkSettings.times, "slam_ms": "reading"}

    slam_ms: MeasuredTime = 0.0
    """Processing time of a frame by the reader, in milliseconds; 0 for none."""

    @model_validator(mode="after")
    def _check_slam_ms(self) -> Self:
        if self.link is None and self.slam_ms:
            raise ValueError("slam_ms needs a link; set one, such as link: ideal")
        return self

    @property
    def read_s(self) -> float:
        """Processing time of a frame at the receiver, in seconds."""
        return _seconds(self.slam_ms) * self.receiver_factor


def _seconds(time_ms: float | str) -> float:
    if isinstance(time_ms, str):
        raise TypeError(f"{time_ms!r} is not a time; `with_measured_times` replaces it")
    return 1e-3 * time_ms
