"""All checks of codecs, in the order in which an author should fix failures, and examinations of installed codecs.

An examination runs the checks in a process of the codec's own, so that no codec can end, stop or outlast the examiner.
Results come back as data. A codec that exits, hangs, kills or interrupts its process fails the current check.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Literal, Self

from pydantic import ValidationError

from codecbench.core.conformance import checks, damage
from codecbench.core.conformance.corpus import CodecClass, Entry, EntryResult, check_entry, coded_pictures
from codecbench.core.conformance.harness import Check, ConformanceFailure, NotClaimed, Shape, shape_of
from codecbench.core.conformance.material import Film, conformance_images, moving_pictures, pictures_with_corners
from codecbench.core.conformance.sandbox import Reply, Sandbox
from codecbench.core.contracts.codec import AnyCodec
from codecbench.core.contracts.errors import PluginError, Unsupported
from codecbench.core.contracts.image import Layout
from codecbench.core.contracts.params import Params
from codecbench.core.engine.plugins.registry import installed

Status = Literal["passed", "failed", "skipped"]
_ALL: Final[tuple[Shape, ...]] = ("pictures", "stream", "features")
_IMAGES: Final[tuple[Shape, ...]] = ("pictures", "stream")
_FILMS: Final[tuple[Shape, ...]] = ("stream", "features")

TIMEOUT_S: Final = 300.0
"""Timeout in seconds of one check on images of one layout; the slowest ones compile a counting build."""
_MEMORY_MB: Final = 4096

CHECKS: Final = (
    Check("params", "parameters survive JSON, in which they are stored", checks.params_survive_json, _ALL),
    Check("extract", "features match their image and are repeatable", checks.features_match_the_image, ("features",)),
    Check("bytes", "packets are bytes, so their size can be measured", checks.packets_are_bytes, _ALL),
    Check("flush", "a session loses and repeats no frame", checks.no_frame_is_lost_or_doubled, ("stream",)),
    Check("shape", "decoded images have the shape and dtype of the input", checks.shape_and_type_return, _IMAGES),
    Check("sets", "every packet decodes to its set, and inputs do not change", checks.sets_come_back, ("features",)),
    Check("untouched", "input images do not change, whatever their memory layout", checks.input_is_untouched, _ALL),
    Check("stateless", "results do not depend on order or instance", checks.sessions_repeat, _ALL),
    Check("interleaved", "simultaneous sessions are independent", checks.sessions_do_not_interfere, _FILMS),
    Check("prepared", "preparing a codec changes no byte", checks.preparing_changes_nothing, ("pictures",)),
    Check("one_in_one_out", "low-delay settings hold back no frame", checks.one_in_gives_one_out, ("stream",)),
    Check("future", "sent packets do not depend on later frames", checks.what_was_sent_is_final, ("stream",)),
    Check("lossless", "settings that claim to be lossless are", checks.lossless_means_lossless, _ALL),
    Check("range", "samples are clipped at black and white", checks.samples_stop_at_black_and_white, ("pictures",)),
    Check("empty", "empty feature sets can be coded", checks.empty_sets_are_sets, ("features",)),
    Check("limits", "sets too large to be coded are refused", checks.large_sets_are_coded_or_refused, ("features",)),
    Check("bad_images", "only images of a declared layout are accepted", checks.bad_images_are_refused, _ALL),
    Check("libraries", "third-party libraries are listed with versions", checks.libraries_are_named, _ALL),
    Check("starts", "decoding from any declared keyframe gives the same frames", damage.starts_are_starts, _FILMS),
    Check("loss", "after any packet loss, only intact frames are marked whole", damage.losses_are_reported, _FILMS),
    Check("deterministic", "another process writes the same bytes", checks.another_process_encodes_alike, _ALL),
    Check("self_contained", "packets decode in another process and setting", checks.packets_alone_decode, _ALL),
    Check("threads", "an instance that claims to be thread-safe is", checks.threads_do_not_interfere, _ALL),
    Check("foreign", "foreign bytes are refused", damage.foreign_bytes_are_refused, _ALL),
    Check("cut", "cut or extended bitstreams are refused", damage.cut_streams_are_refused, ("pictures", "features")),
    Check("damaged", "damaged bitstreams are refused or decoded safely", damage.damaged_streams_are_survived, _ALL),
    Check("bombs", "headers with huge sizes cost little time and memory", damage.huge_headers_are_survived, _ALL),
    Check("partial", "partial decoding marks only correct pixels as whole", damage.parts_decode, ("pictures",)),
    Check("counting", "counting changes no byte and is repeatable", checks.counting_changes_nothing, _IMAGES),
)


@dataclass(frozen=True)
class CheckResult:
    """Result of one check on images of one layout."""

    check: Check
    layout: Layout
    """Layout of the images."""
    status: Status
    reason: str = ""
    """Why it failed or was skipped."""

    def __str__(self) -> str:
        mark = "FAILED" if self.status == "failed" else self.status
        return f"{mark} {self.check.name} ({self.layout})" + (f": {self.reason}" if self.reason else "")


def checks_of(shape: Shape) -> tuple[Check, ...]:
    """Return the checks for codecs of a shape."""
    return tuple(check for check in CHECKS if shape in check.shapes)


def films_of(shape: Shape, layout: Layout) -> list[Film]:
    """Return the test sequences of one layout for codecs of a shape."""
    if shape == "pictures":
        return conformance_images(layout)
    return moving_pictures(layout) if shape == "stream" else pictures_with_corners(layout)


def run_checks(
    codec_class: type[AnyCodec[Any]], params: Params, checks: Sequence[Check] | None = None
) -> list[CheckResult]:
    """Run all checks for this shape of codec, or the given ones, on every layout that this setting takes."""
    selection = checks_of(shape_of(codec_class)) if checks is None else checks
    layouts = codec_class(params).capabilities.layouts
    return [run_check(check, layout, codec_class, params) for check in selection for layout in layouts]


def run_check(check: Check, layout: Layout, codec_class: type[AnyCodec[Any]], params: Params) -> CheckResult:
    """Run one check on images of one layout."""
    try:
        check.function(codec_class, params, films_of(shape_of(codec_class), layout))
    except NotClaimed as claim:
        return CheckResult(check, layout, "skipped", str(claim))
    except ConformanceFailure as failure:
        return CheckResult(check, layout, "failed", str(failure))
    except Exception as error:  # noqa: BLE001 - a codec may raise anything, which is a finding too
        return CheckResult(check, layout, "failed", f"raised {type(error).__name__}: {error}")
    return CheckResult(check, layout, "passed")


@dataclass(frozen=True)
class Subject:
    """A codec setting to examine, as data."""

    codec: str
    version: str
    setting: dict[str, Any]
    """Parameters as the user gave them."""
    params: dict[str, Any]
    """All parameters, as JSON types."""
    libraries: dict[str, str]
    """Versions by name."""
    layouts: tuple[Layout, ...]
    """Layouts that this setting takes."""
    shape: Shape
    """What it codes, which selects the checks."""


@dataclass(frozen=True)
class Unexamined:
    """Why a codec cannot be examined."""

    kind: str
    """The condition that is not met, `available` or `valid`; or `broken`."""
    reason: str


class Examiner:
    """Examines codecs, those of each distribution in a fresh process; as a context manager it ends the process."""

    def __init__(self, timeout_s: float = TIMEOUT_S) -> None:
        self._timeout_s = timeout_s
        self._sandbox = Sandbox(may_start_others=True)
        self._distribution = ""
        self._hung = ""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._sandbox.stop()

    def subjects(self, codec: str, settings: list[dict[str, Any]]) -> list[Subject] | Unexamined:
        """Return the codec at these settings, or at its examples. Raises PluginError if it is not installed."""
        self._use_process_for(codec)
        self._hung = ""
        reply = self._ask(_subjects, codec, settings)
        subjects: list[Subject] | Unexamined = reply.value
        return subjects if reply.status == "done" else Unexamined("broken", f"{reply.status}: {reply.reason}")

    def results(self, subject: Subject, check: Check) -> Iterator[CheckResult]:
        """Run a check on each layout. After a check that hung, no more are run on this codec."""
        for layout in subject.layouts:
            if self._hung:
                yield CheckResult(check, layout, "skipped", f"not run, because {self._hung} hung")
                continue
            reply = self._ask(_result, subject, check.name, layout)
            if reply.status == "hung":
                self._hung = check.name
            failure = CheckResult(check, layout, "failed", f"{reply.status}: {reply.reason}")
            yield reply.value if reply.status == "done" else failure

    def coded_pictures(self, subject: Subject, earlier: Sequence[Entry]) -> list[tuple[Entry, bytes]]:
        """Run `corpus.coded_pictures` in the process. Raises PluginError also if the codec ends its process."""
        self._use_process_for(subject.codec)
        reply = self._ask(_coded_pictures, subject, list(earlier))
        if reply.status != "done" or isinstance(reply.value, str):
            fault = f"{subject.codec}: {reply.status}: {reply.reason}"
            raise PluginError(reply.value if reply.status == "done" else fault)
        bitstreams: list[tuple[Entry, bytes]] = reply.value
        return bitstreams

    def entry_result(self, folder: Path, entry: Entry) -> EntryResult:
        """Run `corpus.check_entry`, in this process for codecbench's own codecs."""
        try:
            if not installed().find("codec", entry.codec).hosted:
                return check_entry(folder, entry, _load)
        except PluginError as error:
            return EntryResult(entry, "skipped", str(error))
        self._use_process_for(entry.codec)
        reply = self._ask(check_entry, folder.absolute(), entry, _load)
        failure = EntryResult(entry, "failed", f"{reply.status}: {reply.reason}")
        return reply.value if reply.status == "done" else failure

    def _use_process_for(self, codec: str) -> None:
        """Start a fresh process if the codec is of another distribution than the one before."""
        distribution = installed().find("codec", codec).distribution
        if distribution != self._distribution:
            self._sandbox.stop()
            self._distribution = distribution

    def _ask(self, function: Any, *arguments: Any) -> Reply:
        return self._sandbox.call(function, *arguments, timeout_s=self._timeout_s, memory_mb=_MEMORY_MB)


def _subjects(codec: str, settings: list[dict[str, Any]]) -> list[Subject] | Unexamined:
    try:
        codec_class: Any = installed().load("codec", codec)
        return [_subject(codec_class, setting) for setting in settings or codec_class.examples]
    except Unsupported as missing:
        return Unexamined("available", str(missing))
    except PluginError as error:
        return Unexamined("broken", str(error))
    except ValidationError as error:
        return Unexamined("valid", str(error))


def _load(codec: str) -> CodecClass:
    codec_class: CodecClass = installed().load("codec", codec)
    return codec_class


def _coded_pictures(subject: Subject, earlier: list[Entry]) -> list[tuple[Entry, bytes]] | str:
    codec_class = _load(subject.codec)
    try:
        return coded_pictures(codec_class, codec_class.params_type.model_validate(subject.setting), earlier)
    except PluginError as error:
        return str(error)


def _subject(codec_class: Any, setting: dict[str, Any]) -> Subject:
    params = codec_class.params_type.model_validate(setting)
    codec = codec_class(params)
    libraries = {str(name): str(version) for name, version in codec.libraries().items()}
    dumped = params.model_dump(mode="json")
    layouts = tuple(Layout(*layout) for layout in codec.capabilities.layouts)
    return Subject(str(codec.name), str(codec.version), setting, dumped, libraries, layouts, shape_of(codec_class))


def _result(subject: Subject, check_name: str, layout: Layout) -> CheckResult:
    codec_class: Any = installed().load("codec", subject.codec)
    params = codec_class.params_type.model_validate(subject.setting)
    check = next(check for check in CHECKS if check.name == check_name)
    return run_check(check, layout, codec_class, params)
