"""Proxies for objects of another process: calls on them are executed there."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterator
from functools import partial
from types import SimpleNamespace
from typing import Any, cast

from codecbench.core.contracts.codec import AnyCodec, Capabilities, Decoder
from codecbench.core.contracts.recipe import Recipe, Scene
from codecbench.core.contracts.stream import StreamEncoder
from codecbench.core.engine.hosting.channel import FACTS, METHODS, Channel, PluginFault


class Remote:
    """An object at the other end of a channel: its facts are attributes, and its methods are called there.

    place: the channel, and the object's number there.
    """

    def __init__(self, channel: Channel, number: int, kind: str, facts: dict[str, Any]) -> None:
        self.place, self.kind, self._methods = (channel, number), kind, METHODS[kind]
        self.facts = {name: facts[name] for name in FACTS.get(kind, ())} | facts
        if kind != "codec":  # two proxies may share a codec
            weakref.finalize(self, _drop, channel, number).atexit = False

    def call(self, name: str, *arguments: Any, **words: Any) -> Any:
        """Call a method, see `Channel.call`; a function `module:name` gets this object as its first argument."""
        words.pop("trace", None)  # operations are counted in the host, see `AnyCodec.at_encoder`
        if self.kind == "slam_backend":
            arguments = (iter(arguments[0]), *arguments[1:])
        return self.place[0].call(self, name, *arguments, **words)

    def __getattr__(self, name: str) -> Any:
        if name in vars(self).get("facts", ()):
            return self.facts[name]
        if name in vars(self).get("_methods", ()):
            return partial(self.call, name)
        raise AttributeError(f"{name} cannot be used on an object of another process")

    def __len__(self) -> int:
        return len(self.sequence if self.kind == "coded" else self.timestamps_s)

    def __iter__(self) -> Iterator[Any]:
        """Iterate over itself if it is an iterator, otherwise over the frames of a sequence."""
        if self.kind == "iterator":
            return self
        return (getattr(self, "frame" if self.kind == "coded" else "read")(index) for index in range(len(self)))

    def __next__(self) -> Any:
        return self.call("__next__")

    def __call__(self, *arguments: Any) -> Any:
        return self.call("__call__", *arguments)


class RemoteParams(SimpleNamespace):
    """Parameters as JSON types, each an attribute."""

    def model_dump(self, **_: Any) -> dict[str, Any]:
        return dict(vars(self))


class RemoteCodec(Remote, AnyCodec[Any]):
    """A codec in another process; in a worker, in two, so that the decoder never saw what was encoded.

    encoding, decoding: return the codec in that process, and are called when it is first needed. Questions about the
    setting alone go to the process that described it first. Raises PluginFault if the codec's facts violate the
    contract.
    """

    def __init__(
        self,
        channel: Channel,
        number: int,
        kind: str,
        facts: dict[str, Any],
        encoding: Callable[[], Remote] | None = None,
        decoding: Callable[[], Remote] | None = None,
    ) -> None:
        Remote.__init__(self, channel, number, kind, facts)
        self.name, self.version, self.carries = facts["name"], facts["version"], facts["carries"]  # type: ignore[misc]
        self.stateless, self.capabilities = facts["stateless"], facts["capabilities"]  # type: ignore[misc]
        self.params = RemoteParams(**facts["params"])
        if not isinstance(self.capabilities, Capabilities) or self.carries not in ("pictures", "features"):
            raise PluginFault(f"{self.name}: its capabilities or carries are invalid")
        here = cast("Callable[[], Remote]", lambda: self)
        self._encoding, self._decoding = encoding or here, decoding or here

    def open_encoder(self, frame_rate_hz: float) -> StreamEncoder:
        return self._encoding().call("open_encoder", frame_rate_hz)  # type: ignore[no-any-return]

    def open_decoder(self) -> Decoder:
        return self._decoding().call("open_decoder")  # type: ignore[no-any-return]

    def encode(self, image: Any, **_: Any) -> Any:
        return self._encoding().call("encode", image)

    def decode(self, bitstream: bytes, **_: Any) -> Any:
        return self._decoding().call("decode", bitstream)

    def decode_partial(self, fragments: Any, **_: Any) -> Any:
        return self._decoding().call("decode_partial", list(fragments))

    def prepared(self, image: Any) -> Any:
        encoder = self._encoding()
        codec = encoder.call("prepared", image)
        return self if codec is encoder else codec

    def extract(self, image: Any) -> Any:
        """Extract features, at the encoder's end."""
        return self._encoding().call("extract", image)

    def encoder(self) -> Any:
        """Open a session of the codec's own class."""
        return self._encoding().call("encoder")

    def decoder(self) -> Any:
        """Open a session of the codec's own class."""
        return self._decoding().call("decoder")

    def with_params(self, **values: Any) -> Any:
        return self._encoding().call("with_params", **values)

    def at_encoder(self, function: Callable[..., Any], *arguments: Any) -> Any:
        return self._encoding().call(f"{function.__module__}:{function.__qualname__}", *arguments)

    def at_decoder(self, function: Callable[..., Any], *arguments: Any) -> Any:
        return self._decoding().call(f"{function.__module__}:{function.__qualname__}", *arguments)

    def is_lossless(self) -> bool:
        return bool(self.call("is_lossless"))

    def is_low_delay(self) -> bool:
        return bool(self.call("is_low_delay"))

    def remark_at(self, bits: int) -> Any:
        return self.call("remark_at", bits)

    def libraries(self) -> Any:
        return self.call("libraries")

    def recipes(self, scene: Scene) -> tuple[Recipe, ...]:
        return self.call("recipes", scene)  # type: ignore[no-any-return]


def _drop(channel: Channel, number: int) -> None:
    channel.dropped.append(number)


def remote(channel: Channel, number: int, kind: str, facts: dict[str, Any]) -> Remote:
    """Return a proxy for an object at the other end of a channel."""
    return (RemoteCodec if kind == "codec" else Remote)(channel, number, kind, facts)
