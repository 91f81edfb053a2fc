"""All checks, in the order in which a codec's author wants to hear of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from codecbench.core.conformance import (
    counting,
    isolation,
    partial,
    robustness,
    round_trip,
    stream_isolation,
    stream_losses,
    stream_round_trip,
)
from codecbench.core.conformance.failure import ConformanceFailure, NotClaimed
from codecbench.core.conformance.images import conformance_images
from codecbench.core.conformance.moving_pictures import moving_pictures
from codecbench.core.contracts.codec import AnyCodec
from codecbench.core.contracts.params import Params
from codecbench.core.contracts.stream import StreamCodec


@dataclass(frozen=True)
class Check:
    """A named check: what it proves, and the function that raises ConformanceFailure where a codec falls short.

    The function takes the class, a setting, and the material for that shape of codec: NamedImages for one that codes
    pictures on their own, MovingPictures for one with memory.
    """

    name: str
    proves: str
    function: Callable[[Any, Params, Sequence[Any]], None]


Status = Literal["passed", "failed", "skipped"]


@dataclass(frozen=True)
class CheckResult:
    """How one check went for images of one layout, and why where it did not pass."""

    check: Check
    channels: int
    status: Status
    reason: str = ""

    @property
    def layout(self) -> str:
        """`gray` or `colour`."""
        return "gray" if self.channels == 1 else "colour"

    def __str__(self) -> str:
        mark = "FAILED" if self.status == "failed" else self.status
        return f"{mark} {self.check.name} ({self.layout})" + (f": {self.reason}" if self.reason else "")


CHECKS: tuple[Check, ...] = (
    Check("params", "parameters survive JSON, which is how they are stored", round_trip.params_survive_json),
    Check("bytes", "a bitstream is bytes, so its size is what is measured", round_trip.bytes_in_between),
    Check("shape", "decoded images are uint8, of the shape that went in", round_trip.shape_and_type_return),
    Check("untouched", "encoding leaves the image alone, however it lies in memory", round_trip.input_is_untouched),
    Check("stateless", "order and instance make no difference", round_trip.one_instance_keeps_no_state),
    Check(
        "prepared", "what a codec finds on an image beforehand changes no byte", round_trip.preparing_changes_nothing
    ),
    Check("lossless", "settings that claim to be lossless are", round_trip.lossless_means_lossless),
    Check("range", "samples stop at black and at white", round_trip.samples_stop_at_black_and_white),
    Check("bad_images", "what is no image of a declared layout is refused", round_trip.bad_images_are_refused),
    Check("libraries", "foreign libraries are named with their versions", round_trip.libraries_are_named),
    Check("deterministic", "another process writes the same bytes", isolation.another_process_encodes_alike),
    Check("self_contained", "the bytes alone decode: another process, another setting", isolation.bytes_alone_decode),
    Check("threads", "an instance that claims to be thread-safe is", isolation.threads_do_not_interfere),
    Check("foreign", "foreign bytes are refused", robustness.foreign_bytes_are_refused),
    Check("cut", "cut or prolonged bitstreams are refused", robustness.cut_streams_are_refused),
    Check("damaged", "damaged bitstreams neither crash, hang nor raise", robustness.damaged_streams_are_survived),
    Check("bombs", "headers that claim too much cost little", robustness.huge_headers_are_survived),
    Check("partial", "parts of a bitstream give no more than they claim", partial.parts_decode),
    Check("counting", "counting operations changes no byte and repeats exactly", counting.counting_changes_nothing),
)
"""Of codecs that code pictures on their own."""

STREAM_CHECKS: tuple[Check, ...] = (
    Check("params", "parameters survive JSON, which is how they are stored", round_trip.params_survive_json),
    Check("bytes", "packets are bytes, so their size is what is measured", stream_round_trip.packets_are_bytes),
    Check("flush", "no frame is lost or doubled when a session ends", stream_round_trip.no_frame_is_lost_or_doubled),
    Check("shape", "decoded images are uint8, of the shape that went in", stream_round_trip.shape_and_type_return),
    Check("untouched", "pictures are left alone, and may change after push", stream_round_trip.input_is_untouched),
    Check("stateless", "sessions repeat, on the same instance and on another", stream_isolation.sessions_repeat),
    Check("interleaved", "two sessions at once know nothing of each other", stream_isolation.sessions_do_not_interfere),
    Check("one_in_one_out", "where low delay is claimed, nothing waits", stream_round_trip.one_in_gives_one_out),
    Check("future", "what was sent is final and says nothing of what comes", stream_round_trip.what_was_sent_is_final),
    Check("lossless", "settings that claim to be lossless are", stream_round_trip.lossless_means_lossless),
    Check(
        "bad_images",
        "no image of a declared layout or another shape: refused",
        stream_round_trip.bad_images_are_refused,
    ),
    Check("libraries", "foreign libraries are named with their versions", round_trip.libraries_are_named),
    Check("starts", "decoding from each declared start gives the same pictures", stream_losses.starts_are_starts),
    Check("loss", "whatever packet is lost, only whole pictures are called so", stream_losses.losses_are_told),
    Check("deterministic", "another process writes the same packets", stream_isolation.another_process_encodes_alike),
    Check(
        "self_contained",
        "packets alone decode: another process, another setting",
        stream_isolation.packets_alone_decode,
    ),
    Check("threads", "an instance that claims to be thread-safe is", stream_isolation.threads_do_not_interfere),
    Check("foreign", "foreign bytes are refused", stream_losses.foreign_bytes_are_refused),
    Check("damaged", "damaged packets neither crash, hang nor raise", stream_losses.damaged_streams_are_survived),
    Check("bombs", "headers that claim too much cost little", stream_losses.huge_headers_are_survived),
    Check("counting", "counting operations changes no byte", stream_round_trip.counting_changes_nothing),
)
"""Of codecs with memory."""


def checks_of(is_stream: bool) -> tuple[Check, ...]:
    """The checks for codecs with memory, or for those that code pictures on their own."""
    return STREAM_CHECKS if is_stream else CHECKS


def run_checks(
    codec_class: type[AnyCodec[Any]], params: Params, checks: Sequence[Check] | None = None
) -> list[CheckResult]:
    """Every check for this shape of codec, or those given, on every layout that the codec declares."""
    chosen = checks_of(issubclass(codec_class, StreamCodec)) if checks is None else checks
    layouts = codec_class.capabilities.channels
    return [run_check(check, channels, codec_class, params) for check in chosen for channels in layouts]


def run_check(check: Check, channels: int, codec_class: type[AnyCodec[Any]], params: Params) -> CheckResult:
    """One check on images of one layout."""
    material: Any = moving_pictures if issubclass(codec_class, StreamCodec) else conformance_images
    try:
        check.function(codec_class, params, material(channels))
    except NotClaimed as claim:
        return CheckResult(check, channels, "skipped", str(claim))
    except ConformanceFailure as failure:
        return CheckResult(check, channels, "failed", str(failure))
    except Exception as error:  # noqa: BLE001 - a codec may raise anything, which is a finding too
        return CheckResult(check, channels, "failed", f"raised {type(error).__name__}: {error}")
    return CheckResult(check, channels, "passed")
