"""Examination of installed codecs in processes of their own, so that none can end, stop or outlast the examiner.

Results come back as data. A codec that exits, hangs, kills or interrupts its process fails the current check.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

from pydantic import ValidationError

from codecbench.core.conformance.corpus import CodecClass, Entry, EntryResult, check_entry, coded_pictures
from codecbench.core.conformance.harness import Check, Shape, shape_of
from codecbench.core.conformance.sandbox import Reply, Sandbox
from codecbench.core.conformance.suite import CHECKS, CheckResult, run_check
from codecbench.core.contracts.errors import PluginError, Unsupported
from codecbench.core.engine.plugins.registry import installed

TIMEOUT_S: Final = 300.0
"""Timeout in seconds of one check on images of one layout; the slowest ones compile a counting build."""
_MEMORY_MB: Final = 4096


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
    channels: tuple[int, ...]
    """Layouts that the codec declares."""
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
        for channels in subject.channels:
            if self._hung:
                yield CheckResult(check, channels, "skipped", f"not run, because {self._hung} hung")
                continue
            reply = self._ask(_result, subject, check.name, channels)
            if reply.status == "hung":
                self._hung = check.name
            failure = CheckResult(check, channels, "failed", f"{reply.status}: {reply.reason}")
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
    libraries = {str(name): str(version) for name, version in codec_class(params).libraries().items()}
    dumped = params.model_dump(mode="json")
    channels = tuple(int(count) for count in codec_class.capabilities.channels)
    return Subject(
        str(codec_class.name),
        str(codec_class.version),
        setting,
        dumped,
        libraries,
        channels,
        shape_of(codec_class),
    )


def _result(subject: Subject, check_name: str, channels: int) -> CheckResult:
    codec_class: Any = installed().load("codec", subject.codec)
    params = codec_class.params_type.model_validate(subject.setting)
    check = next(check for check in CHECKS if check.name == check_name)
    return run_check(check, channels, codec_class, params)
