"""`codecbench verify`."""

from __future__ import annotations

import json
import platform
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import click
from pydantic import ValidationError

from codecbench.core.conformance.corpus import CodecClass, EntryResult, check_corpus, write_corpus
from codecbench.core.conformance.settings import setting_from_text, setting_label
from codecbench.core.conformance.suite import CHECKS, Check, CheckResult, run_checks
from codecbench.core.contracts.errors import PluginError, Unsupported
from codecbench.core.contracts.params import Params
from codecbench.core.engine.registry import Plugin, installed

_MARKS = {"passed": ("pass", "green"), "failed": ("FAIL", "red"), "skipped": ("skip", "yellow")}
_FOLDER = click.Path(path_type=Path, file_okay=False)


@click.command()
@click.argument("codecs", nargs=-1, metavar="[CODEC]...")
@click.option("--settings", multiple=True, metavar="'KEY=VALUE ...'", help="Check CODEC at this setting; repeatable.")
@click.option("--only", multiple=True, type=click.Choice([check.name for check in CHECKS]), metavar="CHECK",
              help="Run only this check; repeatable.")  # fmt: skip
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
    json_path: Path | None,
    write_to: Path | None,
    check_in: Path | None,
) -> None:
    """Check that codecs do what the contract asks: those named, or all that are installed.

    Each is checked at its example settings, or at those given. With --write-corpus or --check-corpus the corpus is
    written or checked, and no check is run. The exit status is 1 if anything fails, if a codec that was named is
    not available, or if there was nothing to check.
    """
    if write_to is not None and check_in is not None:
        raise click.UsageError("--write-corpus and --check-corpus are two runs")
    if settings and len(codecs) != 1:
        raise click.UsageError("--settings needs exactly one CODEC")
    if check_in is not None and settings:
        raise click.UsageError("--check-corpus takes its settings from the corpus")
    report = _Report(to_stderr=str(json_path) == "-")
    if check_in is not None:
        for result in check_corpus(check_in, _load, codecs):
            report.of_entry(result)
    else:
        cases = _cases(codecs, settings, report)
        if write_to is not None:
            report.of_corpus(write_to, cases)
        else:
            for case in cases:
                report.of_case(case, [check for check in CHECKS if not only or check.name in only])
    report.finish(json_path)
    context.exit(0 if report.counts["passed"] and not report.counts["failed"] else 1)


@dataclass(frozen=True)
class _Case:
    """A codec setting to be checked."""

    plugin: Plugin
    codec_class: CodecClass
    setting: dict[str, Any]
    params: Params
    libraries: dict[str, str]


def _load(name: str) -> CodecClass:
    codec_class: CodecClass = installed().load("codec", name)
    return codec_class


def _cases(codecs: tuple[str, ...], settings: tuple[str, ...], report: _Report) -> list[_Case]:
    """The settings to check; codecs that cannot be are reported. Raises PluginError for an unknown name."""
    registry = installed()
    plugins = [registry.find("codec", name) for name in codecs] or registry.plugins("codec")
    cases: list[_Case] = []
    for plugin in plugins:
        name = plugin.spec.name
        try:
            codec_class = _load(name)
            for setting in [setting_from_text(text) for text in settings] or codec_class.examples:
                params = codec_class.params_type.model_validate(setting)
                libraries = codec_class(params).libraries()
                cases.append(_Case(plugin, codec_class, setting, params, libraries))
        except Unsupported as missing:
            report.unchecked(name, "failed" if codecs else "skipped", str(missing))
        except (PluginError, ValidationError) as error:
            if settings and isinstance(error, ValidationError):
                raise click.UsageError(f"--settings of {name}: {error}") from None
            report.unchecked(name, "failed", str(error))
    return cases


class _Report:
    """Lines for people while results come in, and the same results for programs at the end."""

    def __init__(self, to_stderr: bool) -> None:
        self.counts: Counter[str] = Counter(passed=0, failed=0, skipped=0)
        self._to_stderr = to_stderr
        self._content: dict[str, list[Any]] = {"settings": [], "unchecked": [], "corpus": []}

    def of_case(self, case: _Case, checks: list[Check]) -> None:
        """Run the checks on one setting."""
        codec_class = case.codec_class
        self._say(f"{setting_label(codec_class.name, case.setting)}  (version {codec_class.version})", bold=True)
        results: list[CheckResult] = []
        for check in checks:
            found = run_checks(codec_class, case.params, [check])
            self._line(check, found)
            results += found
        self._content["settings"].append(
            {
                "codec": codec_class.name,
                "version": codec_class.version,
                "distribution": case.plugin.distribution,
                "libraries": case.libraries,
                "params": case.params.model_dump(mode="json"),
                "checks": [
                    {
                        "name": result.check.name,
                        "proves": result.check.proves,
                        "layout": result.layout,
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

    def of_corpus(self, folder: Path, cases: list[_Case]) -> None:
        """Write a corpus of the settings."""
        from codecbench import __version__

        settings = [(case.codec_class, case.params) for case in cases]
        entries = write_corpus(folder, settings, f"codecbench {__version__}")
        self._content["corpus"] += [asdict(entry) for entry in entries]
        self.counts["passed"] += len(entries)
        self._say(f"{folder}: {len(entries)} bitstreams of {len(cases)} settings")

    def of_entry(self, result: EntryResult) -> None:
        """Report a bitstream of a corpus; one that passed without remark is only counted."""
        entry = result.entry
        self._content["corpus"].append(asdict(result))
        if result.status == "passed" and not result.note:
            self.counts["passed"] += 1
            return
        self._mark(result.status, f"{entry.file}  {setting_label(entry.codec, entry.params)} {entry.shape}")
        self._say(f"        {result.reason or result.note}")

    def unchecked(self, codec: str, status: str, reason: str) -> None:
        """Report a codec that cannot be checked at all."""
        self._content["unchecked"].append({"codec": codec, "status": status, "reason": reason})
        self._say(codec, bold=True)
        self._mark(status, reason)

    def finish(self, json_path: Path | None) -> None:
        """Say the totals, and write everything as JSON."""
        self._say(", ".join(f"{self.counts[status]} {status}" for status in _MARKS), bold=True)
        if json_path is None:
            return
        from codecbench import __version__

        content = {
            "codecbench": __version__,
            "machine": f"{platform.machine()} {platform.system()}, Python {platform.python_version()}",
            **self._content,
            "summary": dict(self.counts),
        }
        with click.open_file(str(json_path), "w") as file:
            file.write(json.dumps(content, indent=1) + "\n")

    def _mark(self, status: str, text: str) -> None:
        self.counts[status] += 1
        word, colour = _MARKS[status]
        self._say(f"  {click.style(word, fg=colour)}  {text}")

    def _say(self, text: str, **style: Any) -> None:
        click.secho(text, err=self._to_stderr, **style)
