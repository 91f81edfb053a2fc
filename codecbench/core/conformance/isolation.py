"""Checks across processes and threads: nothing travels from encoder to decoder but the bytes."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from codecbench.core.conformance.failure import ConformanceFailure, NotClaimed
from codecbench.core.conformance.images import NamedImage
from codecbench.core.conformance.round_trip import CodecClass, encoded, require_equal
from codecbench.core.conformance.sandbox import Verb, sandbox
from codecbench.core.conformance.variations import other_settings
from codecbench.core.contracts.params import Params

_TIMEOUT_S = 120.0
_MEMORY_MB = 2048
_THREADS = 4
_ROUNDS = 3


def _elsewhere(codec_class: CodecClass, params: Params, verb: Verb, argument: Any, where: str) -> Any:
    """What the codec does in another process. Fails where it does not."""
    reply = sandbox(verb).ask(codec_class, params, verb, argument, timeout_s=_TIMEOUT_S, memory_mb=_MEMORY_MB)
    if reply.status != "done":
        raise ConformanceFailure(where, f"{reply.status}: {reply.reason}", "what this process gets")
    return reply.value


def another_process_encodes_alike(codec_class: CodecClass, params: Params, images: Sequence[NamedImage]) -> None:
    for image, bitstream in encoded(codec_class(params), images):
        where = f"encode({image.name}) in another process"
        if _elsewhere(codec_class, params, "encode", image.pixels, where) != bitstream:
            raise ConformanceFailure(where, "other bytes", "equal bytes")


def bytes_alone_decode(codec_class: CodecClass, params: Params, images: Sequence[NamedImage]) -> None:
    """Decode where nothing was encoded, by instances of other settings."""
    codec = codec_class(params)
    settings = [params, *other_settings(params)]
    for index, (image, bitstream) in enumerate(encoded(codec, images)):
        other = settings[index % len(settings)]
        where = f"decode({image.name}) in another process, by the setting {other}"
        require_equal(where, _elsewhere(codec_class, other, "decode", bitstream, where), codec.decode(bitstream))


def threads_do_not_interfere(codec_class: CodecClass, params: Params, images: Sequence[NamedImage]) -> None:
    """One instance in several threads at once gives what it gives alone."""
    if not codec_class.capabilities.thread_safe:
        raise NotClaimed("this codec does not claim to be thread-safe")
    codec = codec_class(params)
    alone = [(image, bitstream, codec.decode(bitstream)) for image, bitstream in encoded(codec, images)]

    def work(offset: int) -> None:
        for image, bitstream, pixels in alone[offset:] + alone[:offset]:
            if codec.encode(image.pixels) != bitstream:
                raise ConformanceFailure(
                    f"encode({image.name}) in one of {_THREADS} threads", "other bytes", "equal bytes"
                )
            require_equal(f"decode({image.name}) in one of {_THREADS} threads", codec.decode(bitstream), pixels)

    with ThreadPoolExecutor(_THREADS) as pool:
        for future in [pool.submit(work, offset % len(alone)) for offset in range(_THREADS * _ROUNDS)]:
            future.result()
