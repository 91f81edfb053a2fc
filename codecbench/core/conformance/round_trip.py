"""Checks of what goes in and what comes out, in this process."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np

from codecbench.core.conformance.failure import ConformanceFailure, NotClaimed
from codecbench.core.conformance.images import NamedImage, saturated_images
from codecbench.core.contracts.codec import Codec
from codecbench.core.contracts.errors import ImageError, Unsupported
from codecbench.core.contracts.image import channel_count
from codecbench.core.contracts.params import Params

CodecClass = type[Codec[Any]]

_ACROSS: Final = 192
"""Three quarters of the range of a sample."""


def encoded(codec: Codec[Any], images: Sequence[NamedImage]) -> Iterator[tuple[NamedImage, bytes]]:
    """The images that the codec takes, each with its bitstream.

    An image may be Unsupported (too small for a rate, say), but not every one of a layout.
    """
    taken, reasons = 0, []
    for image in images:
        try:
            bitstream = codec.encode(image.pixels)
        except Unsupported as error:
            reasons.append(f"{image.name}: {error}")
            continue
        taken += 1
        yield image, bitstream
    if not taken:
        raise ConformanceFailure("encode", f"Unsupported for every image ({'; '.join(reasons[:2])})", "some bitstreams")


def require_equal(where: str, got: Any, expected: Any) -> None:
    """Fail unless two decoded images are the same in shape and pixels."""
    if got.shape != expected.shape:
        raise ConformanceFailure(where, f"shape {got.shape}", f"shape {expected.shape}")
    if not np.array_equal(got, expected):
        place = tuple(int(i) for i in np.argwhere(got != expected)[0])
        count = int(np.count_nonzero(got != expected))
        raise ConformanceFailure(where, f"{got[place]} at {place}, {count} samples differ", f"{expected[place]} there")


def params_survive_json(codec_class: CodecClass, params: Params, images: Sequence[NamedImage]) -> None:
    again = type(params).model_validate(json.loads(json.dumps(params.model_dump(mode="json"))))
    if again != params:
        raise ConformanceFailure("params", f"{again!r} after JSON", repr(params))
    if json.dumps(again.identity(), sort_keys=True) != json.dumps(params.identity(), sort_keys=True):
        raise ConformanceFailure("params.identity()", again.identity(), repr(params.identity()))


def bytes_in_between(codec_class: CodecClass, params: Params, images: Sequence[NamedImage]) -> None:
    for image, bitstream in encoded(codec_class(params), images):
        if type(bitstream) is not bytes or not bitstream:
            raise ConformanceFailure(f"encode({image.name})", f"{type(bitstream).__name__} {bitstream!r:.40}", "bytes")


def shape_and_type_return(codec_class: CodecClass, params: Params, images: Sequence[NamedImage]) -> None:
    codec = codec_class(params)
    for image, bitstream in encoded(codec, images):
        decoded = codec.decode(bitstream)
        if not isinstance(decoded, np.ndarray) or decoded.dtype != np.uint8:
            got = f"{type(decoded).__name__} {getattr(decoded, 'dtype', '')}"
            raise ConformanceFailure(f"decode({image.name})", got, "a uint8 array")
        allowed = {image.pixels.shape} if not _may_turn_gray(params) else {image.pixels.shape, image.pixels.shape[:2]}
        if decoded.shape not in allowed:
            raise ConformanceFailure(f"decode({image.name})", f"shape {decoded.shape}", f"shape {image.pixels.shape}")
        if not decoded.flags.writeable or not decoded.flags.c_contiguous:
            raise ConformanceFailure(
                f"decode({image.name})", "a read-only or strided array", "one that the caller owns"
            )


def _may_turn_gray(params: Params) -> bool:
    """Whether the setting asks in so many words for colour to be dropped."""
    return "gray" in (getattr(params, "color", None), getattr(params, "colour", None))


def input_is_untouched(codec_class: CodecClass, params: Params, images: Sequence[NamedImage]) -> None:
    codec = codec_class(params)
    for image, bitstream in encoded(codec, images):
        before = image.pixels.copy()
        given = image.pixels.copy()
        codec.encode(given)
        require_equal(f"the image given to encode({image.name})", given, before)
        given.flags.writeable = False
        if codec.encode(given) != bitstream:
            raise ConformanceFailure(
                f"encode({image.name}), read-only", "other bytes", "the same as for a writable copy"
            )
        strided = np.repeat(image.pixels, 2, axis=1)[:, ::2]
        if codec.encode(strided) != bitstream:
            raise ConformanceFailure(f"encode({image.name}), a strided view", "other bytes", "the same as for a copy")


def one_instance_keeps_no_state(codec_class: CodecClass, params: Params, images: Sequence[NamedImage]) -> None:
    codec = codec_class(params)
    first = list(encoded(codec, images))
    decoded = [codec.decode(bitstream) for _, bitstream in first]
    for (image, bitstream), pixels in zip(reversed(first), reversed(decoded), strict=True):
        if codec.encode(image.pixels) != bitstream:
            raise ConformanceFailure(f"encode({image.name}) again, in another order", "other bytes", "equal bytes")
        if codec_class(params).encode(image.pixels) != bitstream:
            raise ConformanceFailure(f"encode({image.name}) by a new instance", "other bytes", "equal bytes")
        require_equal(f"decode({image.name}) again, in another order", codec.decode(bitstream), pixels)


def preparing_changes_nothing(codec_class: CodecClass, params: Params, images: Sequence[NamedImage]) -> None:
    """Instances prepared for each image write the bytes of the instance that they come from, which stays as it is."""
    codec = codec_class(params)
    first = list(encoded(codec, images))
    prepared = [codec.prepared(image.pixels) for image, _ in first]
    for ready, (image, bitstream) in zip(prepared, first, strict=True):
        if type(ready) is not codec_class or ready.params != params:
            raise ConformanceFailure(f"prepared({image.name})", ready, f"{codec_class.__name__} of the same parameters")
        if ready.encode(image.pixels) != bitstream:
            raise ConformanceFailure(f"prepared({image.name}).encode({image.name})", "other bytes", "those of encode")
        if codec.encode(image.pixels) != bitstream:
            raise ConformanceFailure(f"encode({image.name}) after prepared({image.name})", "other bytes", "equal bytes")


def lossless_means_lossless(codec_class: CodecClass, params: Params, images: Sequence[NamedImage]) -> None:
    codec = codec_class(params)
    if not codec.is_lossless():
        raise NotClaimed("this setting does not claim to be lossless")
    for image, bitstream in encoded(codec, images):
        require_equal(f"decode({image.name}) of a lossless setting", codec.decode(bitstream), image.pixels)


def samples_stop_at_black_and_white(codec_class: CodecClass, params: Params, images: Sequence[NamedImage]) -> None:
    """No decoded sample jumps to the other end of the range, which is where one that wraps round comes out."""
    codec = codec_class(params)
    for image, bitstream in encoded(codec, saturated_images(channel_count(images[0].pixels))):
        decoded = codec.decode(bitstream)
        if decoded.shape != image.pixels.shape:  # turned gray, as `shape` allows where it is asked for
            continue
        wrapped = _wrapped(decoded.astype(np.int16), image.pixels.astype(np.int16))
        if wrapped.any():
            place = tuple(int(i) for i in np.argwhere(wrapped)[0])
            got = f"{decoded[place]} at {place}, far from its neighbour; {np.count_nonzero(wrapped)} such"
            raise ConformanceFailure(f"decode({image.name})", got, f"about {image.pixels[place]}")


def _wrapped(decoded: Any, original: Any) -> Any:
    """Samples at the wrong end of the range beside a neighbour that is not, where the image has no edge.

    An error alone proves nothing: a coarse setting may smear black over white, but smoothly.
    """
    wrong = np.abs(decoded - original) > _ACROSS
    beside = np.zeros_like(wrong)
    for axis in (0, 1):
        flat = np.diff(original, axis=axis) == 0
        flat = flat if flat.ndim == 2 else flat.all(axis=2, keepdims=True)  # colour that turns gray mixes its channels
        jump = (np.abs(np.diff(decoded, axis=axis)) > _ACROSS) & flat
        before, after = np.zeros_like(wrong), np.zeros_like(wrong)
        np.moveaxis(before, axis, 0)[:-1] = np.moveaxis(jump, axis, 0)
        np.moveaxis(after, axis, 0)[1:] = np.moveaxis(jump, axis, 0)
        beside |= before | after
    return wrong & beside


def bad_images_are_refused(codec_class: CodecClass, params: Params, images: Sequence[NamedImage]) -> None:
    codec = codec_class(params)
    bad: dict[str, Any] = {
        "uint16": np.zeros((8, 8), np.uint16),
        "float64": np.zeros((8, 8)),
        "bool": np.zeros((8, 8), np.bool_),
        "four channels": np.zeros((8, 8, 4), np.uint8),
        "two channels": np.zeros((8, 8, 2), np.uint8),
        "one dimension": np.zeros(8, np.uint8),
        "no rows": np.zeros((0, 8), np.uint8),
        "no columns": np.zeros((8, 0, 3), np.uint8),
        "a list": [[0, 1], [2, 3]],
    }
    for layout, shape in ((1, (8, 8)), (3, (8, 8, 3))):
        if layout not in codec_class.capabilities.channels:
            bad[f"{layout} channel(s), not in capabilities"] = np.zeros(shape, np.uint8)
    for name, value in bad.items():
        try:
            bitstream = codec.encode(value)
        except ImageError:
            continue
        except Exception as error:
            raise ConformanceFailure(f"encode({name})", f"{type(error).__name__}: {error}", "ImageError") from error
        raise ConformanceFailure(f"encode({name})", f"{len(bitstream)} bytes", "ImageError")


def libraries_are_named(codec_class: CodecClass, params: Params, images: Sequence[NamedImage]) -> None:
    libraries = codec_class(params).libraries()
    if not all(isinstance(name, str) and isinstance(version, str) and version for name, version in libraries.items()):
        raise ConformanceFailure("libraries()", libraries, "names and versions as text")
