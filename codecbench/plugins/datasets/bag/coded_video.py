"""Topics of coded video, one packet a message: random access to their frames, decoded by FFmpeg."""

from __future__ import annotations

import re
from bisect import bisect_right
from contextlib import suppress
from typing import Any, Final

import numpy as np

from codecbench.core.contracts.errors import DatasetError, Unsupported
from codecbench.core.contracts.image import MAX_PIXELS, Image
from codecbench.plugins.codecs.video.library import decoding_errors, load_av, packet_for, samples_of_frame
from codecbench.plugins.datasets.bag.recording import Integers, Recording, Topic
from codecbench.plugins.datasets.selection import already_coded

_DECODERS: Final = {"264": "h264", "265": "hevc", "hevc": "hevc", "vp9": "vp9", "av1": "libdav1d"}
"""FFmpeg's decoders by what the name of a format or of its encoder contains, such as `h265` or `hevc_nvenc`."""
_LONGEST_DELAY: Final = 32
"""Number of packets after a frame's own within which it leaves the decoder; H.264 and HEVC reorder by at most 16."""

_SAMPLED_KEYS: Final = 5
_GAP: Final = 1.5
"""A longer time between frames, in median times, may be a loss."""


def is_key_frame(decoder: str, data: bytes) -> bool:
    """Whether decoding may begin at a packet: at a picture without references, or the parameters that precede it.

    Specifications: ITU-T H.264, 7.4.1; ITU-T H.265, 7.4.2.2; VP9 bitstream, 6.2; AV1 bitstream, 5.3 and 7.5.
    """
    if decoder == "vp9":
        last_bit = 1 if data[:1] and data[0] & 0x30 == 0x30 else 2  # profile 3 has one more bit before it
        return bool(data) and data[0] >> 6 == 2 and not data[0] >> last_bit & 3
    if decoder == "libdav1d":
        return data[:1] == b"\x0a" or data[:3] == b"\x12\x00\x0a"  # a sequence header, maybe after a delimiter
    units = [unit[0] for unit in data.split(b"\0\0\1")[1:] if unit]
    if decoder == "hevc":
        return any(16 <= unit >> 1 & 63 <= 21 for unit in units)
    return any(unit & 31 in (5, 7) for unit in units)


class CodedVideo:
    """The frames of a topic of coded video. Decodes forward, and begins again at key frames.

    Raises DatasetError if no frame can be decoded.

    coding: name of the codec. sizes_bytes: of all packets. first: number of the first message whose frame can
    be decoded.
    """

    def __init__(self, recording: Recording, topic: Topic) -> None:
        self._recording, self._topic = recording, topic
        format_ = recording.message(topic, 0).format
        self.coding = re.split("[;/]", format_)[0].strip()[:40]
        self._decoder = next((name for part, name in _DECODERS.items() if part in self.coding.lower()), "")
        where = f"{recording.path}: {topic.name}"
        try:
            load_av()
        except Unsupported as error:
            raise DatasetError(f"{where}: {topic.type} cannot be decoded: {error}") from error
        if not self._decoder:
            raise DatasetError(f"{where}: format {format_[:40]!r} is not supported; supported: h264, h265, vp9, av1")
        self.sizes_bytes: list[int] = []
        self._keys: list[int] = []
        for number in range(len(recording.index(topic)[0])):
            content = b""
            with suppress(DatasetError):  # decoding the message raises it again
                content = self._packet(number)
            self.sizes_bytes.append(len(content))
            if is_key_frame(self._decoder, content):
                self._keys.append(number)
        if not self._keys:
            raise DatasetError(f"{where}: none of its {len(topic)} packets of {self.coding} is a key frame")
        self._context: Any = None
        self._next = -1
        self._inside: set[int] = set()
        """Frames that have not left the decoder."""
        self._ready: dict[int, Any] = {}
        """Frames that have, and were not asked for."""
        self._damage: dict[int, tuple[int, str]] = {}
        """By number of a key frame: the first damaged message after it, and what is wrong with it."""
        self._begin(self._keys[0])
        while self._context is not None and not self._ready:
            self._feed()
        if not self._ready:
            raise DatasetError(f"{where}: none of its {len(topic)} packets of {self.coding} can be decoded")
        self.first = min(self._ready)  # with gradual refresh it is later than the first key frame

    def image(self, number: int) -> Image:
        """Decode the frame of a message to gray (H, W) or RGB (H, W, 3).

        Raises DatasetError if the message is damaged, or one that it depends on.
        """
        frame = self._frame(number)
        return samples_of_frame(frame, "gray" if frame.format.name.startswith("gray") else "rgb24")

    def shows_color(self) -> bool:
        """Whether some of the key frames show any color; a gray camera's video may be stored with empty chroma."""
        sampled = self._keys[:: max(len(self._keys) // _SAMPLED_KEYS, 1)]
        images = (self.image(max(key, self.first)) for key in sampled)
        return any(image.ndim == 3 and np.ptp(image, axis=2).any() for image in images)

    def notes(self, times_ns: Integers, size: tuple[int, int]) -> list[str]:
        """Notes on the loss in all frames, from their times and their width and height in pixels."""
        steps_s, mean_bits = np.diff(times_ns) / 1e9, 8.0 * float(np.mean(self.sizes_bytes[self.first :]))
        rate = f", {mean_bits / (size[0] * size[1]):.3g} bits per pixel"
        if not len(steps_s):
            return [already_coded(f"the topic has {self.coding} video{rate}")]
        step_s = float(np.median(steps_s))
        notes = [already_coded(f"the topic has {self.coding} video, {mean_bits / step_s / 1000:.0f} kbit/s{rate}")]
        if gaps := int((steps_s > _GAP * step_s).sum()):
            notes.append(
                f"gaps in the frames' times: {gaps}; if packets were lost, frames are damaged up to the next key frame"
            )
        return notes

    def key_before(self, number: int) -> int:
        """Number of the last key frame at or before a message."""
        return self._keys[bisect_right(self._keys, number) - 1]

    def _frame(self, number: int) -> Any:
        keys = self._keys[: bisect_right(self._keys, number)]
        for key in reversed(keys):  # the first frames after a key frame may depend on those before it (open GOP)
            self._fail_if_damaged(keys[-1], number)
            if number not in self._ready and number not in self._inside and not key <= self._next <= number:
                self._begin(key)
            while number not in self._ready and self._context is not None and self._next <= number + _LONGEST_DELAY:
                self._feed()
            self._fail_if_damaged(keys[-1], number)
            if number in self._ready:
                break
            self._close()
        else:
            raise DatasetError(f"{self._recording.where(self._topic, number)}: decodes to no frame")
        for earlier in list(self._ready):  # they leave the decoder in the order of their times
            frame = self._ready.pop(earlier)
            if earlier == number:
                break
        return frame

    def _begin(self, key: int) -> None:
        """Open a decoder at a key frame, with the first one's parameters, which others need not repeat."""
        self._close()
        self._context = load_av().CodecContext.create(self._decoder, "r")
        self._context.thread_count = 1
        self._context.options = {"max_pixels": str(MAX_PIXELS)}
        if self._decoder in ("h264", "hevc"):
            self._context.extradata = self._packet(self._keys[0])
        self._next = key
        self._ready = {}

    def _close(self) -> None:
        self._context, self._next, self._inside = None, -1, set()

    def _feed(self) -> None:
        """Give the decoder the next packet, or the end after the last, and collect its frames."""
        number, self._next = self._next, self._next + 1
        is_end = number == len(self.sizes_bytes)
        refusals: tuple[type[Exception], ...] = (DatasetError, *decoding_errors())
        try:
            frames = self._context.decode(None if is_end else packet_for(self._packet(number), number))
            self._inside.add(number)
        except refusals as error:
            self._damage.setdefault(self.key_before(number), (number, str(error)))
            is_end, frames = True, []
            with suppress(*decoding_errors()):
                frames = self._context.decode(None)
        for frame in frames:
            if frame.is_corrupt:
                self._damage.setdefault(self.key_before(frame.pts), (frame.pts, "FFmpeg replaced parts of its frame"))
            self._ready[frame.pts] = frame
        self._inside.difference_update(self._ready)
        if is_end:
            self._close()

    def _packet(self, number: int) -> bytes:
        """The bytes of a packet. Raises DatasetError if there are none, which FFmpeg takes for the end."""
        content = bytes(self._recording.message(self._topic, number).data)
        if not content:
            raise DatasetError("it is empty")
        return content

    def _fail_if_damaged(self, key: int, number: int) -> None:
        damaged, reason = self._damage.get(key, (number + 1, ""))
        if damaged <= number:
            raise DatasetError(
                f"{self._recording.where(self._topic, number)}: cannot be decoded: message {damaged} is damaged "
                f"({reason}), and frames up to the next key frame depend on it"
            )
