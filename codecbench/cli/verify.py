"""`codecbench verify`."""

from __future__ import annotations

import json
import platform
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import click

from codecbench import __version__
from codecbench.cli.messages import ExitStatus
from codecbench.cli.parameters import codec_names
from codecbench.core.conformance.corpus import EntryResult, read_manifest, write_bitstreams
from codecbench.core.conformance.harness import Check
from codecbench.core.conformance.settings import setting_from_text, setting_label
from codecbench.core.conformance.suite import CHECKS, TIMEOUT_S, CheckResult, Examiner, Subject, Unexamined, checks_of
from codecbench.core.contracts.errors import PluginError
from codecbench.core.engine.plugins.plugin import Plugin
from codecbench.core.engine.plugins.registry import installed
from codecbench.core.engine.storage.atomic import write_file

_MARKS = {"passed": ("pass", "green"), "failed": ("FAIL", "red"), "skipped": ("skip", "yellow")}
_CHECK_NAMES = [check.name for check in CHECKS]
_FOLDER = click.Path(path_type=Path, file_okay=False)


@click.command()
@click.argument("codecs", nargs=-1, metavar="[CODEC]...", shell_complete=codec_names)
@click.option("--settings", multiple=True, metavar="'KEY=VALUE ...'", help="Check CODEC at this setting; repeatable.")
@click.option("--only", multiple=True, type=click.Choice(_CHECK_NAMES), metavar="CHECK",
              help="Run only this check; repeatable.")  # fmt: skip
@click.option("--timeout", type=click.FloatRange(min=0, min_open=True), default=TIMEOUT_S, show_default=True,
              metavar="SECONDS", help="Time limit of one check on gray or on color images.")  # fmt: skip
@click.option("--json", "json_path", type=click.Path(path_type=Path, allow_dash=True), metavar="FILE",
              help="Write the results as JSON; `-` is standard output.")  # fmt: skip
@click.option("--write-corpus", "write_to", type=_FOLDER, help="Write bitstreams with their hashes into a new folder.")
@click.option("--check-corpus", "check_in", type=_FOLDER, help="Check that the bitstreams of a folder still decode.")
@click.pass_context
def verify(
    context: click.Context,
    codecs: tuple[str, ...],
    settings: tuple[str, ...],
    only: tuple[str, ...],
    timeout: float,
    json_path: Path | None,
    write_to: Path | None,
    check_in: Path | None,
) -> None:
    """Check that codecs meet their contract: the given ones, or all that are installed.

    Each check runs at the codec's example settings, or at the given ones, in its own process with a time limit. With
    --write-corpus or --check-corpus, only the corpus is written or checked. The exit status is 1 if anything fails, if
    a given codec is not available, or if there was nothing to check.
    """
    if write_to is not None and check_in is not None:
        raise click.UsageError("give --write-corpus or --check-corpus, not both")
    if settings and len(codecs) != 1:
        raise click.UsageError("--settings needs exactly one CODEC")
    if check_in is not None and settings:
        raise click.UsageError("--check-corpus reads the settings from the corpus; omit --settings")
    report = _Report(to_stderr=str(json_path) == "-")
    with Examiner(timeout) as examiner:
        if check_in is not None:
            for entry in read_manifest(check_in):
                if not codecs or entry.codec in codecs:
                    report.report_entry(examiner.entry_result(check_in, entry))
        else:
            subjects = _subjects(codecs, settings, examiner, report)
            if write_to is not None:
                report.report_corpus(write_to, _image_subjects([subject for _, subject in subjects], report), examiner)
            else:
                for plugin, subject in subjects:
                    checks = [check for check in checks_of(subject.shape) if not only or check.name in only]
                    report.report_subject(plugin, subject, checks, examiner)
    report.finish(json_path)
    is_well = report.counts["passed"] and not report.counts["failed"]
    context.exit(ExitStatus.SUCCESS if is_well else ExitStatus.FOUND)


def _plugins(codecs: tuple[str, ...]) -> list[Plugin]:
    """Return the named codecs, or all. Raises PluginError for an unknown name."""
    registry = installed()
    return [registry.find("codec", name) for name in codecs] or registry.plugins("codec")


def _subjects(
    codecs: tuple[str, ...], settings: tuple[str, ...], examiner: Examiner, report: _Report
) -> Iterator[tuple[Plugin, Subject]]:
    """Yield every codec at every setting. Reports unavailable codecs, as failed if they were named."""
    for plugin in _plugins(codecs):
        subjects = examiner.subjects(plugin.spec.name, [setting_from_text(text) for text in settings])
        if not isinstance(subjects, Unexamined):
            yield from ((plugin, subject) for subject in subjects)
        elif subjects.kind == "valid" and settings:
            raise click.UsageError(f"--settings of {plugin.spec.name}: {subjects.reason}")
        else:
            is_absent = subjects.kind == "available" and not codecs
            report.report_unchecked(plugin.spec.name, "skipped" if is_absent else "failed", subjects.reason)


def _image_subjects(subjects: list[Subject], report: _Report) -> list[Subject]:
    """Return the subjects that a corpus can contain, codecs of single images; reports the others as skipped."""
    for codec in dict.fromkeys(subject.codec for subject in subjects if subject.shape != "pictures"):
        report.report_unchecked(codec, "skipped", "a corpus contains single images, and this codec codes sequences")
    return [subject for subject in subjects if subject.shape == "pictures"]


class _Report:
    """Prints results as they come in, and writes them as JSON at the end."""

    def __init__(self, to_stderr: bool) -> None:
        self.counts: Counter[str] = Counter(passed=0, failed=0, skipped=0)
        self._to_stderr = to_stderr
        self._content: dict[str, list[Any]] = {"settings": [], "unchecked": [], "corpus": []}

    def report_subject(self, plugin: Plugin, subject: Subject, checks: list[Check], examiner: Examiner) -> None:
        """Run the checks on one setting."""
        self._say(f"{setting_label(subject.codec, subject.setting)}  (version {subject.version})", bold=True)
        results: list[CheckResult] = []
        for check in checks:
            check_results = list(examiner.results(subject, check))
            self._line(check, check_results)
            results += check_results
        self._content["settings"].append(
            {
                "codec": subject.codec,
                "version": subject.version,
                "distribution": plugin.distribution,
                "libraries": subject.libraries,
                "params": subject.params,
                "checks": [
                    {
                        "name": result.check.name,
                        "proves": result.check.proves,
                        "layout": str(result.layout),
                        "status": result.status,
                        "reason": result.reason,
                    }
                    for result in results
                ],
            }
        )

    def _line(self, check: Check, results: list[CheckResult]) -> None:
        statuses = {result.status for result in results}
        worst = next(status for status in ("failed", "passed", "skipped") if status in statuses)
        self._mark(worst, f"{check.name:<15} {results[0].reason if worst == 'skipped' else check.proves}")
        for result in results:
            if result.status == "failed":
                self._say(f"        {result.layout}: {result.reason}")

    def report_corpus(self, folder: Path, subjects: list[Subject], examiner: Examiner) -> None:
        """Write a corpus of the settings. A codec that fails ends this and is reported."""
        try:
            makers = [partial(examiner.coded_pictures, subject) for subject in subjects]
            entries = write_bitstreams(folder, makers, f"codecbench {__version__}")
        except PluginError as error:
            self._mark("failed", str(error))
            return
        self._content["corpus"] += [asdict(entry) for entry in entries]
        self.counts["passed"] += len(entries)
        self._say(f"{folder}: {len(entries)} bitstreams of {len(subjects)} settings")

    def report_entry(self, result: EntryResult) -> None:
        """Report a bitstream of a corpus. One that passed without a note is only counted."""
        entry = result.entry
        self._content["corpus"].append(asdict(result))
        if result.status == "passed" and not result.note:
            self.counts["passed"] += 1
            return
        self._mark(result.status, f"{entry.file}  {setting_label(entry.codec, entry.params)} {entry.shape}")
        self._say(f"        {result.reason or result.note}")

    def report_unchecked(self, codec: str, status: str, reason: str) -> None:
        """Report a codec that cannot be checked at all."""
        self._content["unchecked"].append({"codec": codec, "status": status, "reason": reason})
        self._say(codec, bold=True)
        self._mark(status, reason)

    def finish(self, json_path: Path | None) -> None:
        """Print the totals, and write everything as JSON."""
        self._say(", ".join(f"{self.counts[status]} {status}" for status in _MARKS), bold=True)
        if json_path is None:
            return

        content = {
            "codecbench": __version__,
            "machine": f"{platform.machine()} {platform.system()}, Python {platform.python_version()}",
            **self._content,
            "summary": dict(self.counts),
        }
        text = json.dumps(content, indent=1)
        if str(json_path) == "-":
            click.echo(text)
        else:
            write_file(json_path, f"{text}\n".encode())

    def _mark(self, status: str, text: str) -> None:
        self.counts[status] += 1
        word, color = _MARKS[status]
        self._say(f"  {click.style(word, fg=color)}  {text}")

    def _say(self, text: str, **style: Any) -> None:
        click.secho(text, err=self._to_stderr, **style)
