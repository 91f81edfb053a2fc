"""Renders the HTML page of a run, and writes reports."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable
from functools import partial
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import jinja2
from markupsafe import Markup

from codecbench.core.analysis.run_result import Column, RunResult, judged_column, successes
from codecbench.core.contracts.errors import ParamsError
from codecbench.core.engine.planning.matrix import VERSION as MATRIX_VERSION
from codecbench.core.engine.storage.atomic import write_file
from codecbench.core.engine.text import counted
from codecbench.core.report.answers import answers_of_settings
from codecbench.core.report.choosing import link_verdicts
from codecbench.core.report.formatting import Verdict, verdicts
from codecbench.core.report.page_data import page_data, verdict_tables
from codecbench.core.report.picks import answer_tables, text_to_paste
from codecbench.core.report.pictures import frame_pictures
from codecbench.core.report.strips import link_strips, strips
from codecbench.core.report.tables import calibration_notes, caveats, sequence_notes, setting_notes
from codecbench.core.report.views import STROKES, first_view

SIZE_LIMIT_BYTES: Final = 6_000_000
"""Size limit of the page: frames take what its other parts leave, and settings that do not fit are left out."""

_REST_BYTES: Final = 250_000
"""Reserved for the page's text, style and scripts."""
_SCRIPTS: Final = ("chart.js", "page.js", "curves.js", "look.js", "tables.js")
_TRACEBACK_LETTERS: Final = 4000
"""Letters at the end of a traceback that the page shows."""

_LEAD: Final = re.compile(r"((?:\((?:[^()]|\([^()]*\))*\)|[^;(])*)(.*)")

_MOST_FAILURES: Final = 500
"""Cells without a result whose reason the page shows."""


def render(run: RunResult, frames: Callable[[int], dict[str, Any]]) -> str:
    """Render the page as HTML text.

    frames: returns `frames` and `originals` for the script, given how many bytes they may take.
    """
    data = page_data(run)
    parts = files("codecbench.core.report")
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    template = environment.from_string((parts / "page.html.j2").read_text(encoding="utf-8"))
    failures = _failures(run)
    failure_bytes = sum(len(text.encode()) for failure in failures for text in failure.values())
    spent_bytes = len(_script_json(data).encode()) + len(run.plan.matrix_text.encode()) + failure_bytes
    data |= frames(SIZE_LIMIT_BYTES - _REST_BYTES - spent_bytes)
    decisions = verdicts(run)
    first = first_view(run)
    judged = judged_column(run) if first is None else first.y
    ranked = next((verdict for verdict in decisions if verdict.about is not None and verdict.about == judged), None)
    others = [verdict for verdict in decisions if verdict is not ranked]
    success_columns = successes(run)
    answers = answers_of_settings(run)
    timelines = [view for view in data["map_views"] if any(drawing["timeline"] for drawing in view["drawings"])]
    return template.render(
        name=run.plan.name,
        subtitle=_subtitle(run),
        css=Markup((parts / "page.css").read_text(encoding="utf-8")),
        scripts=[Markup((parts / name).read_text(encoding="utf-8")) for name in _SCRIPTS],
        data=Markup(_script_json(data)),
        can_look=bool(data["frames"] or timelines),
        has_paths=bool(timelines),
        path_strokes={name: stroke for view in timelines for name, stroke in view["strokes"].items() if _is_map(view)},
        map_views=data["map_views"],
        bars_views=data["bars_views"],
        strokes=STROKES,
        example=next(
            (f"{r.cell.codec.name} {r.cell.codec.label}".strip() for r in run.results if r.cell.codec.label), ""
        ),
        cards=_cards(run),
        link_verdicts=link_verdicts(run),
        cut=_cut,
        answers=answers,
        strips=[strips(run, of) for of in answers],
        link_strips=link_strips(run),
        ranked=ranked,
        decided=_group(others),
        verdicts=verdict_tables(run),
        sequence_notes=sequence_notes(run),
        notes=[*caveats(run), *setting_notes(run)],
        answer_caveats=[
            *calibration_notes(run),
            *_caveats(run, [judged, *(column for columns in success_columns[:1] for column in columns)]),
        ],
        verdict_caveats=_caveats(
            run,
            [*(verdict.about for verdict in others), *(column for columns in success_columns for column in columns)],
        ),
        failures=failures,
        failures_left_out=sum(result.status != "ok" for result in run.results) - len(failures),
        codes=_codes(run),
        environment=json.dumps(run.environments, indent=1, sort_keys=True),
        plugin_distributions=_plugin_distributions(run),
        matrix=run.plan.matrix_text,
        folder=run.folder.name,
        version=version("codecbench"),
    )


def _cut(answer: str) -> list[tuple[str, str]]:
    """Split each line of an answer at its first semicolon outside brackets."""
    return [_LEAD.findall(line)[0] for line in answer.split("\n")]


def _group(verdicts: list[Verdict]) -> list[list[Verdict]]:
    """Group verdicts by their subject, those of single sequences after that of all."""
    groups: dict[str, list[Verdict]] = {}
    for verdict in verdicts:
        _, _, words = verdict.title.partition(": ")
        groups.setdefault(words if verdict.about is None else verdict.about.name, []).append(verdict)
    return list(groups.values())


def _is_map(view: dict[str, Any]) -> bool:
    """Whether a timeline of the view has positions."""
    return any(drawing["timeline"] and drawing["timeline"]["x"] for drawing in view["drawings"])


def _script_json(value: Any) -> str:
    """JSON that cannot end the script element that holds it."""
    return json.dumps(value, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def _caveats(run: RunResult, columns: Iterable[Column | None]) -> list[str]:
    """The caveats of the evaluators of some columns."""
    return caveats(run, {column.evaluator.title for column in columns if column is not None})


def _subtitle(run: RunResult) -> str:
    sequences = ", ".join(f"{entry.name} ({counted(entry.frames, 'frame')})" for entry in run.plan.sequences)
    return f"{sequences}; matrix version {MATRIX_VERSION}"


def _cards(run: RunResult) -> list[dict[str, str]]:
    done = sum(result.status == "ok" for result in run.results)
    failed, unsupported = len(run.failed), sum(result.status == "unsupported" for result in run.results)
    settings = {(result.cell.codec.name, result.cell.codec.label) for result in run.results}
    evaluators = sorted({result.cell.evaluator.title for result in run.results})
    codecs = counted(len({codec for codec, _ in settings}), "codec")
    cards = [
        {"title": "Cells computed", "value": f"{done} of {len(run.plan.cells)}", "tone": "good" if not failed else "",
         "note": f"{failed} failed, {unsupported} unsupported, {run.missing} not yet run"},
        {"title": "Codec settings", "value": str(len(settings)), "tone": "",
         "note": f"{codecs} on {counted(len(run.plan.sequences), 'sequence')}"},
        {"title": "Evaluators", "value": str(len(evaluators)), "tone": "", "note": ", ".join(evaluators)},
    ]  # fmt: skip
    known = {
        json.dumps(environment.get("machine", {}), sort_keys=True): environment.get("machine", {})
        for environment in run.environments.values()
    }
    machines = [str(machine.get("cpu") or "unknown processor") for machine in known.values()]
    several = f"{len(machines)} machines: do not compare times"
    note = "times are valid for this machine only" if len(machines) < 2 else several
    return [*cards, {"title": "Machine", "value": machines[0] if machines else "unknown", "tone": "", "note": note}]


def _codes(run: RunResult) -> list[list[str]]:
    """A row for each plugin and version of its code: plugin, distribution, fingerprint, how many cells."""
    counts = Counter(item for result in run.results if result.status == "ok" for item in result.code.items())
    rows = [[label, *code.rpartition(" ")[::2], str(count)] for (label, code), count in sorted(counts.items())]
    several = {label for label, count in Counter(row[0] for row in rows).items() if count > 1}
    return [[*row, "its other cells ran other code: do not compare them" if row[0] in several else ""] for row in rows]


def _plugin_distributions(run: RunResult) -> list[str]:
    """How many cells ran code of other plugin distributions, which, and what confined it, in words."""
    counts: Counter[tuple[str, str]] = Counter()
    for result in run.results:
        names = sorted({plugin.distribution for plugin in result.cell.plugins if plugin.distribution})
        if names and result.worker:
            tool = result.worker.get("confined")
            counts[" and ".join(names), f"confined by {tool}" if tool else "not confined"] += 1
    return [f"{counted(count, 'cell')} with code of {names}, {how}" for (names, how), count in counts.items()]


def _failures(run: RunResult) -> list[dict[str, str]]:
    """Title, reason and traceback of each cell without a result, as far as the page shows them."""
    failures = []
    repeated = {cell.evaluator.title for cell in run.plan.cells if cell.repeat}
    for result in [result for result in run.results if result.status != "ok"][:_MOST_FAILURES]:
        cell = result.cell
        setting = " ".join(filter(None, (cell.codec.name, cell.codec.label)))
        repeat = f", repeat {cell.repeat}" if cell.evaluator.title in repeated else ""
        failures.append(
            {
                "title": f"{cell.sequence.name}, {setting}, {cell.evaluator.title}{repeat}: {result.status}",
                "reason": result.reason,
                "traceback": result.traceback[-_TRACEBACK_LETTERS:],
                "cell": cell.id[:12],
            }
        )
    return failures


def write_report(
    run: RunResult,
    path: Path,
    format_: str = "html",
    *,
    sequences_from: str | None = None,
    frames: Collection[int] = (),
) -> int:
    """Write the report of a run and return its size in bytes.

    `html`: the whole page. `markdown` or `md`, `latex`: the pick of each codec and the answer, for a pull request or a
    paper. sequences_from: where to find the frames that the page shows: a folder, or `same` for the plan's path; None
    shows only frames of a run that was made here. frames: numbers of the frames to show, from 0; by default a few.
    Raises ParamsError for another format, and for a frame that no sequence has.
    """
    longest = max((entry.frames for entry in run.plan.sequences), default=0)
    if beyond := [number for number in frames if not 0 <= number < longest]:
        raise ParamsError(f"no sequence of the run has frame {beyond[0]}; frames are 0 to {longest - 1}")
    if format_ == "html":
        content = render(run, partial(frame_pictures, run, sequences_from=sequences_from, wanted=frames)).encode()
    elif format_ in ("markdown", "md", "latex"):
        content = text_to_paste(run, answer_tables(run), "latex" if format_ == "latex" else "markdown").encode()
    else:
        raise ParamsError(f"format {format_!r} is not one of html, markdown, latex")
    write_file(path, content)
    return len(content)
