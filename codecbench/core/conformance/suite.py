"""All checks, in the order in which a codec's author wants to hear of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from codecbench.core.conformance import counting, isolation, robustness, round_trip
from codecbench.core.conformance.failure import ConformanceFailure, NotClaimed
from codecbench.core.conformance.images import NamedImage, conformance_images
from codecbench.core.contracts.codec import Codec
from codecbench.core.contracts.params import Params


@dataclass(frozen=True)
class Check:
    """A named check: what it proves, and the function that raises ConformanceFailure where a codec falls short."""

    name: str
    proves: str
    function: Callable[[type[Codec[Any]], Params, Sequence[NamedImage]], None]


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
    Check("bad_images", "what is no image of a declared layout is refused", round_trip.bad_images_are_refused),
    Check("libraries", "foreign libraries are named with their versions", round_trip.libraries_are_named),
    Check("deterministic", "another process writes the same bytes", isolation.another_process_encodes_alike),
    Check("self_contained", "the bytes alone decode: another process, another setting", isolation.bytes_alone_decode),
    Check("threads", "an instance that claims to be thread-safe is", isolation.threads_do_not_interfere),
    Check("foreign", "foreign bytes are refused", robustness.foreign_bytes_are_refused),
    Check("cut", "cut or prolonged bitstreams are refused", robustness.cut_streams_are_refused),
    Check("damaged", "damaged bitstreams neither crash, hang nor raise", robustness.damaged_streams_are_survived),
    Check("bombs", "headers that claim too much cost little", robustness.huge_headers_are_survived),
    Check("counting", "counting operations changes no byte and repeats exactly", counting.counting_changes_nothing),
)


def run_checks(codec_class: type[Codec[Any]], params: Params, checks: Sequence[Check] = CHECKS) -> list[CheckResult]:
    """Every check on every layout that the codec declares."""
    layouts = codec_class.capabilities.channels
    return [run_check(check, channels, codec_class, params) for check in checks for channels in layouts]


def run_check(check: Check, channels: int, codec_class: type[Codec[Any]], params: Params) -> CheckResult:
    """One check on images of one layout."""
    try:
        check.function(codec_class, params, conformance_images(channels))
    except NotClaimed as claim:
        return CheckResult(check, channels, "skipped", str(claim))
    except ConformanceFailure as failure:
        return CheckResult(check, channels, "failed", str(failure))
    except Exception as error:  # noqa: BLE001 - a codec may raise anything, which is a finding too
        return CheckResult(check, channels, "failed", f"raised {type(error).__name__}: {error}")
    return CheckResult(check, channels, "passed")
