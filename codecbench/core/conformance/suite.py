"""All checks, in the order in which a codec's author wants to hear of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from codecbench.core.conformance import (
    counting,
    feature_round_trip,
    feature_sessions,
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
from codecbench.core.conformance.moving_pictures import moving_pictures, pictures_with_corners
from codecbench.core.contracts.codec import AnyCodec
from codecbench.core.contracts.params import Params


@dataclass(frozen=True)
class Check:
    """A named check: what it proves, and the function that raises ConformanceFailure where a codec falls short.

    The function takes the class, a setting, and the material for that shape of codec: NamedImages for one that codes
    pictures on their own, MovingPictures for one with memory or of features.
    """

    name: str
    proves: str
    function: Callable[[Any, Params, Sequence[Any]], None]


Status = Literal["passed", "failed", "skipped"]
Shape = Literal["pictures", "stream", "features"]
"""What a codec codes: pictures on their own, pictures with memory between them, or features."""


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


FEATURE_CHECKS: tuple[Check, ...] = (
    Check("params", "parameters survive JSON, which is how they are stored", round_trip.params_survive_json),
    Check("extract", "what is found is of the picture, and repeats", feature_round_trip.features_are_of_the_picture),
    Check("bytes", "packets are bytes, one for each set, and the first starts", feature_round_trip.packets_are_bytes),
    Check("sets", "every packet gives its set, and sets are left alone", feature_round_trip.sets_come_back),
    Check("stateless", "sessions repeat, on the same instance and on another", feature_sessions.sessions_repeat),
    Check("interleaved", "two sessions at once know nothing of each other", feature_sessions.sessions_do_not_interfere),
    Check("lossless", "settings that claim to be lossless are", feature_round_trip.lossless_means_lossless),
    Check("empty", "a set of no feature is a set", feature_round_trip.empty_sets_are_sets),
    Check("limits", "sets too large to be coded are refused, and change nothing", feature_round_trip.limits_are_kept),
    Check("bad_images", "what is no image of a declared layout is refused", feature_round_trip.bad_images_are_refused),
    Check("libraries", "foreign libraries are named with their versions", round_trip.libraries_are_named),
    Check("starts", "decoding from each declared start gives the same sets", feature_sessions.starts_are_starts),
    Check("loss", "whatever packet is lost, no set is made up", feature_sessions.losses_are_told),
    Check("deterministic", "another process writes the same packets", feature_sessions.another_process_encodes_alike),
    Check(
        "self_contained",
        "packets alone decode: another process, another setting",
        feature_sessions.packets_alone_decode,
    ),
    Check("threads", "an instance that claims to be thread-safe is", feature_sessions.threads_do_not_interfere),
    Check("foreign", "foreign bytes are refused", feature_sessions.foreign_bytes_are_refused),
    Check("damaged", "damaged packets are refused", feature_sessions.damage_is_told),
    Check(
        "bombs", "headers that claim too much are refused at little cost", feature_sessions.huge_headers_are_survived
    ),
)
"""Of codecs of features."""

_CHECKS: dict[Shape, tuple[Check, ...]] = {
    "pictures": CHECKS,
    "stream": STREAM_CHECKS,
    "features": FEATURE_CHECKS,
}
_MATERIAL: dict[Shape, Callable[[int], Any]] = {
    "pictures": conformance_images,
    "stream": moving_pictures,
    "features": pictures_with_corners,
}


def shape_of(codec_class: type[Any]) -> Shape:
    """By which contract a codec goes."""
    if codec_class.carries == "features":
        return "features"
    return "pictures" if codec_class.stateless else "stream"


def checks_of(shape: Shape) -> tuple[Check, ...]:
    """The checks for codecs of a shape."""
    return _CHECKS[shape]


def material_of(shape: Shape, channels: int) -> Any:
    """What the checks for codecs of a shape are given, of one layout."""
    return _MATERIAL[shape](channels)


def run_checks(
    codec_class: type[AnyCodec[Any]], params: Params, checks: Sequence[Check] | None = None
) -> list[CheckResult]:
    """Every check for this shape of codec, or those given, on every layout that the codec declares."""
    chosen = checks_of(shape_of(codec_class)) if checks is None else checks
    layouts = codec_class.capabilities.channels
    return [run_check(check, channels, codec_class, params) for check in chosen for channels in layouts]


def run_check(check: Check, channels: int, codec_class: type[AnyCodec[Any]], params: Params) -> CheckResult:
    """One check on images of one layout."""
    try:
        check.function(codec_class, params, material_of(shape_of(codec_class), channels))
    except NotClaimed as claim:
        return CheckResult(check, channels, "skipped", str(claim))
    except ConformanceFailure as failure:
        return CheckResult(check, channels, "failed", str(failure))
    except Exception as error:  # noqa: BLE001 - a codec may raise anything, which is a finding too
        return CheckResult(check, channels, "failed", f"raised {type(error).__name__}: {error}")
    return CheckResult(check, channels, "passed")
