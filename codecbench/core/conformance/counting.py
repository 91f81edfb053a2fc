"""Checks of the counting build against the fast one."""

from __future__ import annotations

from collections.abc import Sequence

from codecbench.core.conformance.failure import ConformanceFailure
from codecbench.core.conformance.images import NamedImage
from codecbench.core.conformance.round_trip import CodecClass, encoded, require_equal
from codecbench.core.contracts.params import Params
from codecbench.core.counting.trace import CountingTrace


def counting_changes_nothing(codec_class: CodecClass, params: Params, images: Sequence[NamedImage]) -> None:
    """Counted runs give the bytes and pixels of fast ones, the same counts every time, and none if opaque."""
    codec = codec_class(params)
    for image, bitstream in encoded(codec, images):
        encoding, decoding, again = CountingTrace(), CountingTrace(), CountingTrace()
        if codec.encode(image.pixels, trace=encoding) != bitstream:
            raise ConformanceFailure(f"encode({image.name}), counting", "other bytes", "the bytes of the fast build")
        where = f"decode({image.name}), counting"
        require_equal(where, codec.decode(bitstream, trace=decoding), codec.decode(bitstream))
        claims = codec_class.capabilities.counts_operations
        for trace in (encoding, decoding):
            if bool(trace.counts) != claims:
                expected = "counts of every stage" if claims else "none: the codec says that it is opaque"
                raise ConformanceFailure(where, f"stages {list(trace.counts)}", expected)
        codec.encode(image.pixels, trace=again)
        if again.counts != encoding.counts:
            raise ConformanceFailure(f"encode({image.name}), counted twice", "other counts", "equal counts")
