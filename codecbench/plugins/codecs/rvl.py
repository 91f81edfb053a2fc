"""RVL, fast lossless coding of depth frames (Wilson 2017, doi:10.1145/3132272.3134144), as ROS 2 sends it.

A bitstream is the payload of ROS's compressed_depth_image_transport, little-endian:

    bytes  content
    4      format: 0, inverse depth, which is the only one
    8      two float32 parameters of the quantization of 32-bit depth: 0, and not read
    4      width
    4      height
    ...    words of 32 bits, each of 8 nibbles, the first in the upper bits; the last word is filled up with zeros

The nibbles are numbers of 3 bits a nibble, the lower bits first, whose fourth bit says that more follow: the length of
a run of zeros, the length of the run of nonzeros after it, then the differences of these from the nonzero pixel before,
signs folded in as 0, -1, 1, -2; and again, to the last pixel. There is no checksum. The decoder refuses what no encoder
writes, so it notices any cut, and damage that breaks the runs; other damage changes pixels.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.codec import Capabilities, Codec
from codecbench.core.contracts.errors import BitstreamError, ImageError
from codecbench.core.contracts.image import MAX_PIXELS, Image, check_image
from codecbench.core.contracts.params import NoParams
from codecbench.core.contracts.recipe import Recipe, Scene
from codecbench.core.counting.kernel import kernel
from codecbench.core.counting.trace import NULL_TRACE, Trace
from codecbench.plugins.codecs.recipes import compressed_image_transport

_HEADER = struct.Struct("<iffII")
_MOST_BITS = 27  # of a run of MAX_PIXELS
_CUT, _BAD_RUN, _BAD_PIXEL, _LEFT_OVER = range(1, 5)
_REASONS = {
    _CUT: "it ends before its last pixel",
    _BAD_RUN: "a run is empty or exceeds the image",
    _BAD_PIXEL: "a pixel is not within 1..65535",
    _LEFT_OVER: "bits are left over after the last pixel",
}


class Rvl(Codec[NoParams]):
    """Run lengths of holes and differences of depths, in nibbles: for processors too slow for any other codec."""

    name = "rvl"
    version = "1"
    params_type = NoParams
    capabilities = Capabilities(channels=(1,), bits=(16,), lossless=True, counts_operations=True)
    kernels = ("codecbench.plugins.codecs.rvl",)

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> bytes:
        pixels = check_image(image, self.capabilities.channels, self.capabilities.bits)
        height, width = pixels.shape
        if pixels.size > MAX_PIXELS:
            raise ImageError(f"rvl: an image of {width}x{height} exceeds the {MAX_PIXELS} pixels of a decoder")
        words = np.empty(_HEADER.size // 4 + pixels.size + 4, np.uint32)  # up to 7 nibbles a pixel, and the first runs
        _HEADER.pack_into(words.data, 0, 0, 0.0, 0.0, width, height)
        with trace.stage("code runs") as run:
            length = run(encode_runs, pixels.reshape(-1), words[_HEADER.size // 4 :])
        return words[: _HEADER.size // 4 + length].tobytes()

    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Image:
        if len(bitstream) <= _HEADER.size or len(bitstream) % 4:
            raise BitstreamError(f"rvl: {len(bitstream)} bytes are not a header of {_HEADER.size} bytes and words")
        form, _, _, width, height = _HEADER.unpack_from(bitstream)
        if form != 0 or not 0 < width * height <= MAX_PIXELS:
            raise BitstreamError(f"rvl: format {form}, {width}x{height}; 0 and 1..{MAX_PIXELS} pixels are read")
        words = np.frombuffer(bitstream, np.uint32, offset=_HEADER.size)
        pixels = np.zeros(width * height, np.uint16)
        with trace.stage("decode runs") as run:
            status = run(decode_runs, words, pixels)
        if status != 0:
            raise BitstreamError(f"rvl: {_REASONS[status]}")
        return pixels.reshape(height, width)

    def recipes(self, scene: Scene) -> tuple[Recipe, ...]:
        note = "A step of the frame must be a millimeter."
        return (compressed_image_transport({"format": "rvl"}, note, bits=16), *super().recipes(scene))


def _short_codes() -> NDArray[np.int32]:
    """Return, for each 12 bits, the number whose code they begin with, << 4 | its bits; 0 if its code is longer."""
    numbers = np.zeros(1 << 12, np.int32)
    for code in range(numbers.size):
        nibbles = code >> 8, code >> 4 & 15, code & 15
        count = next((place for place, nibble in enumerate(nibbles, 1) if nibble < 8), 0)
        number = sum((nibble & 7) << 3 * place for place, nibble in enumerate(nibbles[:count]))
        numbers[code] = number << 4 | 4 * count
    return numbers


_NUMBERS = _short_codes()


@kernel
def encode_runs(pixels: Any, words: Any) -> Any:
    """Code pixels (n,) uint16 as `words` (n + 4,) uint32; returns how many."""
    size = pixels.shape[0]
    word = np.int64(0)
    bits = np.int64(0)
    position = 0
    previous = np.int64(0)
    start = 0
    while start < size:
        first = start
        while first < size and pixels[first] == 0:
            first += 1
        end = first
        while end < size and pixels[end] != 0:
            end += 1
        word, bits, position = _put(first - start, word, bits, position, words)
        word, bits, position = _put(end - first, word, bits, position, words)
        for i in range(first, end):
            pixel = np.int64(pixels[i])
            delta = pixel - previous
            previous = pixel
            folded = (delta << 1) ^ (delta >> 63)
            if folded < 64:  # one nibble or two, without a branch
                more = np.int64(folded > 7)
                word = (word << 4 | more << 3 | folded & 7) << (more << 2) | folded >> 3
                bits += 4 + (more << 2)
            else:
                word, bits, position = _put(folded, word, bits, position, words)
            words[position] = np.uint32(word >> (bits & 31))  # counts once it is full
            position += bits >> 5
            bits &= 31
        start = end
    if bits > 0:
        words[position] = np.uint32(word << (32 - bits))
        position += 1
    return position


@kernel
def _put(number: Any, word: Any, bits: Any, position: Any, words: Any) -> Any:
    """Append a number; returns the word begun in its lower bits, how many these are, and the words before it."""
    more = True
    while more:
        nibble = number & 7
        number >>= 3
        more = number > 0
        if more:
            nibble |= 8
        word = word << 4 | nibble
        bits += 4
        if bits == 32:
            words[position] = np.uint32(word)
            position += 1
            word = np.int64(0)
            bits = np.int64(0)
    return word, bits, position


@kernel
def decode_runs(words: Any, pixels: Any) -> Any:
    """Decode words (m,) uint32 into pixels (n,) uint16, which are zeros; returns 0, or why they are refused.

    Words are followed by zeros, so that only a run's end has to look for theirs.
    """
    size = pixels.shape[0]
    buffer = np.int64(0)
    bits = np.int64(0)
    position = 0
    previous = np.int64(0)
    start = 0
    while start < size:
        zeros, buffer, bits, position = _get(buffer, bits, position, words)
        run, buffer, bits, position = _get(buffer, bits, position, words)
        first = start + zeros
        end = first + run
        if zeros < 0 or run < 0 or end > size or (zeros == 0 and start > 0) or (run == 0 and end < size):
            return _BAD_RUN
        for i in range(first, end):
            if bits < 12:
                buffer = buffer << 32 | _word(words, position)
                bits += 32
                position += 1
            code = np.int64(_NUMBERS[buffer >> (bits - 12) & 4095])
            bits -= code & 15
            folded = code >> 4
            if code == 0:
                folded, buffer, bits, position = _get(buffer, bits, position, words)
            previous += (folded >> 1) ^ -(folded & 1)
            if folded < 0 or previous < 1 or previous > 65535:
                return _BAD_PIXEL
            pixels[i] = np.uint16(previous)
        if 32 * position - bits > 32 * words.shape[0]:
            return _CUT
        start = end
    if position < words.shape[0] or bits > 31 + 32 * (position - words.shape[0]) or buffer & ((1 << bits) - 1) != 0:
        return _LEFT_OVER
    return 0


@kernel
def _get(buffer: Any, bits: Any, position: Any, words: Any) -> Any:
    """Read a number, -1 if it is too large; returns it, the buffer, its unread lower bits, and the words read."""
    number = np.int64(0)
    shift = 0
    more = True
    while more:
        if shift == _MOST_BITS:
            return np.int64(-1), buffer, bits, position
        if bits < 4:
            buffer = np.int64(_word(words, position))
            bits += 32
            position += 1
        bits -= 4
        nibble = buffer >> bits & 15
        number |= (nibble & 7) << shift
        shift += 3
        more = nibble > 7
    return number, buffer, bits, position


@kernel
def _word(words: Any, position: Any) -> Any:
    """Return a word, 0 behind the last."""
    return np.int64(words[position]) if position < words.shape[0] else np.int64(0)
