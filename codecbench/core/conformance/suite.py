"""All checks of codecs, in the order in which an author should fix failures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

from codecbench.core.conformance import checks, damage
from codecbench.core.conformance.harness import Check, ConformanceFailure, NotClaimed, Shape, shape_of
from codecbench.core.conformance.material import Film, conformance_images, moving_pictures, pictures_with_corners
from codecbench.core.contracts.codec import AnyCodec
from codecbench.core.contracts.params import Params

Status = Literal["passed", "failed", "skipped"]
_ALL: Final[tuple[Shape, ...]] = ("pictures", "stream", "features")
_IMAGES: Final[tuple[Shape, ...]] = ("pictures", "stream")
_FILMS: Final[tuple[Shape, ...]] = ("stream", "features")

CHECKS: Final = (
    Check("params", "parameters survive JSON, which is how they are stored", checks.params_survive_json, _ALL),
    Check("extract", "what is found is of the picture, and repeats", checks.features_match_the_image, ("features",)),
    Check("bytes", "packets are bytes, so their size is what is measured", checks.packets_are_bytes, _ALL),
    Check("flush", "no frame is lost or doubled when a session ends", checks.no_frame_is_lost_or_doubled, ("stream",)),
    Check("shape", "decoded images are uint8, of the shape that went in", checks.shape_and_type_return, _IMAGES),
    Check("sets", "every packet gives its set, and sets are left alone", checks.sets_come_back, ("features",)),
    Check("untouched", "images are left alone, however they lie in memory", checks.input_is_untouched, _ALL),
    Check("stateless", "order and instance make no difference", checks.sessions_repeat, _ALL),
    Check("interleaved", "two sessions at once know nothing of each other", checks.sessions_do_not_interfere, _FILMS),
    Check("prepared", "what is found beforehand changes no byte", checks.preparing_changes_nothing, ("pictures",)),
    Check("one_in_one_out", "where low delay is claimed, nothing waits", checks.one_in_gives_one_out, ("stream",)),
    Check("future", "what has left is final, and tells of no later frame", checks.what_was_sent_is_final, ("stream",)),
    Check("lossless", "settings that claim to be lossless are", checks.lossless_means_lossless, _ALL),
    Check("range", "samples stop at black and at white", checks.samples_stop_at_black_and_white, ("pictures",)),
    Check("empty", "a set of no feature is a set", checks.empty_sets_are_sets, ("features",)),
    Check("limits", "sets too large to be coded are refused", checks.large_sets_are_coded_or_refused, ("features",)),
    Check("bad_images", "what is no image of a declared layout is refused", checks.bad_images_are_refused, _ALL),
    Check("libraries", "foreign libraries are named with their versions", checks.libraries_are_named, _ALL),
    Check("starts", "decoding from each declared start gives the same", damage.starts_are_starts, _FILMS),
    Check("loss", "whatever packet is lost, only what is whole is called so", damage.losses_are_reported, _FILMS),
    Check("deterministic", "another process writes the same bytes", checks.another_process_encodes_alike, _ALL),
    Check("self_contained", "the bytes alone decode: another process and setting", checks.packets_alone_decode, _ALL),
    Check("threads", "an instance that claims to be thread-safe is", checks.threads_do_not_interfere, _ALL),
    Check("foreign", "foreign bytes are refused", damage.foreign_bytes_are_refused, _ALL),
    Check("cut", "cut or prolonged bitstreams are refused", damage.cut_streams_are_refused, ("pictures", "features")),
    Check("damaged", "damaged bitstreams neither crash, hang nor raise", damage.damaged_streams_are_survived, _ALL),
    Check("bombs", "headers that claim too much cost little", damage.huge_headers_are_survived, _ALL),
    Check("partial", "parts of a bitstream give no more than they claim", damage.parts_decode, ("pictures",)),
    Check("counting", "counting operations changes no byte and repeats", checks.counting_changes_nothing, _IMAGES),
)


@dataclass(frozen=True)
class CheckResult:
    """Result of one check on images of one layout."""

    check: Check
    channels: int
    """Layout of the images: 1 gray, 3 RGB."""
    status: Status
    reason: str = ""
    """Why it failed or was skipped."""

    @property
    def layout(self) -> str:
        """`gray` or `colour`."""
        return "gray" if self.channels == 1 else "colour"

    def __str__(self) -> str:
        mark = "FAILED" if self.status == "failed" else self.status
        return f"{mark} {self.check.name} ({self.layout})" + (f": {self.reason}" if self.reason else "")


def checks_of(shape: Shape) -> tuple[Check, ...]:
    """Return the checks for codecs of a shape."""
    return tuple(check for check in CHECKS if shape in check.shapes)


def films_of(shape: Shape, channels: int) -> list[Film]:
    """Return the test sequences of one layout for codecs of a shape."""
    if shape == "pictures":
        return conformance_images(channels)
    return moving_pictures(channels) if shape == "stream" else pictures_with_corners(channels)


def run_checks(
    codec_class: type[AnyCodec[Any]], params: Params, checks: Sequence[Check] | None = None
) -> list[CheckResult]:
    """Run all checks for this shape of codec, or the given ones, on every layout that the codec declares."""
    selection = checks_of(shape_of(codec_class)) if checks is None else checks
    layouts = codec_class.capabilities.channels
    return [run_check(check, channels, codec_class, params) for check in selection for channels in layouts]


def run_check(check: Check, channels: int, codec_class: type[AnyCodec[Any]], params: Params) -> CheckResult:
    """Run one check on images of one layout."""
    try:
        check.function(codec_class, params, films_of(shape_of(codec_class), channels))
    except NotClaimed as claim:
        return CheckResult(check, channels, "skipped", str(claim))
    except ConformanceFailure as failure:
        return CheckResult(check, channels, "failed", str(failure))
    except Exception as error:  # noqa: BLE001 - a codec may raise anything, which is a finding too
        return CheckResult(check, channels, "failed", f"raised {type(error).__name__}: {error}")
    return CheckResult(check, channels, "passed")
