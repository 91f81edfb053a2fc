"""Tables as CSV, Parquet, JSON, Markdown and LaTeX, their numbers as text, and the notes on a run."""

from __future__ import annotations

import difflib
import fnmatch
import io
import json
import math
import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import Any

import pandas as pd

from codecbench.core.analysis.run_result import Column, RunResult, judged_column, successes
from codecbench.core.analysis.table import NOTES, json_value
from codecbench.core.analysis.verdicts import Calibrations, calibrations
from codecbench.core.contracts.errors import ParamsError
from codecbench.core.engine.text import counted

_KEYS = ("sequence", "codec", "setting")
_COUNTABLE = 1e15
"""Numbers from here on have exponents, as all floats of that size are whole."""
_FORMULA = ("=", "+", "-", "@")
_TURNING = 3
"""Settings with a reversed order that are named before the rest is counted."""
_LATEX = str.maketrans(
    {**{special: f"\\{special}" for special in "&%$#_{}"}, "\\": "\\textbackslash{}", "~": "\\textasciitilde{}",
     "^": "\\textasciicircum{}", "\n": " "}
)  # fmt: skip
_LATEX_NUMBERS = {"–": "--", "∞": "$\\infty$", "-∞": "$-\\infty$"}


def export_table(frame: pd.DataFrame, format_: str, below: str = "") -> bytes:
    """Export a table as the bytes of a file: `csv`, `parquet`, `json`, `markdown` or `latex`.

    Numbers keep their full precision in csv, parquet and json; infinities are `inf`, missing values empty. In csv a
    text that spreadsheets would read as a formula gets an apostrophe before it. In markdown and latex numbers have
    three significant digits. below: a sentence below the table in these two, in latex as a comment.
    """
    if format_ == "csv":
        return _no_formulas(frame).to_csv(index=False).encode()
    if format_ == "parquet":
        buffer = io.BytesIO()
        frame.to_parquet(buffer, index=False)
        return buffer.getvalue()
    if format_ == "json":
        records = [
            {str(name): json_value(value) for name, value in record.items()}
            for record in _objects(frame).to_dict("records")
        ]
        return (json.dumps(records, indent=1) + "\n").encode()
    rows = [[format_value(value) for value in row] for row in _objects(frame).to_numpy().tolist()]
    if format_ == "markdown":
        text = foreign_table([str(name) for name in frame.columns], rows)
        return (f"{text}\n{escape(below)}\n" if below else text).encode()
    if format_ == "latex":
        return (_latex(frame, rows) + (f"% {below}\n" if below else "")).encode()
    raise ParamsError(f"format {format_!r} is not one of csv, parquet, json, markdown, latex")


def select_columns(frame: pd.DataFrame, patterns: str) -> pd.DataFrame:
    """Select the identifying columns and those that match one of the comma-separated patterns, in their order.

    The notes stay too, because numbers may mislead without them. Raises ParamsError if a pattern matches nothing.
    """
    names = [str(name) for name in frame.columns]
    chosen = [name for name in _KEYS if name in names]
    for pattern in filter(None, (part.strip() for part in patterns.split(","))):
        matches = [name for name in names if fnmatch.fnmatchcase(name, pattern)]
        if not matches:
            near = difflib.get_close_matches(pattern, names, n=5, cutoff=0.3)
            raise ParamsError(f"no column matches {pattern!r}; near it: {', '.join(near) or 'none'}")
        chosen += [name for name in matches if name not in chosen]
    chosen += [NOTES] if NOTES in names and NOTES not in chosen else []
    return frame[chosen]


def short_table(run: RunResult, *, brief: bool = False) -> pd.DataFrame:
    """The headlines of a run in displayed units, under readable heads.

    brief: narrow heads of one line or more, for a screen that may not fit all columns. The rate and the criteria then
    come first, and before them the status if a row is not ok.
    """
    headlines = run.headlines()
    if brief:
        headlines = list(dict.fromkeys([*_criteria(run), *headlines]))
    parts = [run.wide[column.name] * column.factor for column in headlines]
    heads = [column.short_heading if brief else column.heading for column in headlines]
    at = 0 if brief and (run.wide["status"] != "ok").any() else len(parts)
    table = pd.concat([run.wide[[*_KEYS]], *parts[:at], run.wide["status"], *parts[at:]], axis=1)
    table.columns = pd.Index([*_KEYS, *heads[:at], "status", *heads[at:]])
    return table


def drop_constant_columns(frame: pd.DataFrame) -> tuple[pd.DataFrame, str]:
    """Drop the columns that have one value in all of several rows, and name those values in a sentence."""
    if len(frame) < 2:
        return frame, ""
    same = [frame.iloc[:, at].nunique(dropna=False) == 1 for at in range(frame.shape[1])]
    values = ((name, format_value(frame.iloc[0, at])) for at, name in enumerate(frame.columns) if same[at])
    words = [" ".join(f"{name} {value}".split()) for name, value in values if value]
    return frame.loc[:, [not is_same for is_same in same]], f"In all rows: {', '.join(words)}." if words else ""


def _criteria(run: RunResult) -> list[Column]:
    """The rate, the first success, and the judged column."""
    success = next(iter(successes(run)), [])
    return [column for column in (run.rate, *success, judged_column(run)) if column is not None]


def _objects(frame: pd.DataFrame) -> pd.DataFrame:
    """The table with None for missing values."""
    return frame.astype(object).where(frame.notna(), None)


def _no_formulas(frame: pd.DataFrame) -> pd.DataFrame:
    """Add an apostrophe to each text, heads too, that begins like a formula; numbers stay."""
    texts = [name for name in frame.columns if not pd.api.types.is_numeric_dtype(frame[name].dtype)]
    return frame.assign(**{name: frame[name].map(_no_formula) for name in texts}).rename(columns=_no_formula)


def _no_formula(value: Any) -> Any:
    return f"'{value}" if isinstance(value, str) and value.startswith(_FORMULA) else value


def _latex(frame: pd.DataFrame, rows: list[list[str]]) -> str:
    """A booktabs table; pandas would need jinja2's styler for less control."""
    numeric = [pd.api.types.is_numeric_dtype(kind) for kind in frame.dtypes]
    lines = ["\\begin{tabular}{" + "".join("r" if is_number else "l" for is_number in numeric) + "}", "\\toprule"]
    lines.append(" & ".join(str(name).translate(_LATEX) for name in frame.columns) + " \\\\")
    lines.append("\\midrule")
    lines += [" & ".join(_LATEX_NUMBERS.get(text) or text.translate(_LATEX) for text in row) + " \\\\" for row in rows]
    return "\n".join([*lines, "\\bottomrule", "\\end{tabular}"]) + "\n"


def table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table; cells are text or numbers, None and NaN become a dash."""
    lines = [
        "| " + " | ".join(heads) + " |",
        "|" + "|".join("---" if not i else "---:" for i in range(len(heads))) + "|",
    ]
    lines += ["| " + " | ".join(cell(value) for value in row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def foreign_table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table of foreign text, whose markup is escaped."""
    cells = ([escape(value) if isinstance(value, str) else value for value in row] for row in rows)
    return table([escape(head) for head in heads], cells)


def cell(value: object) -> str:
    """Format a value for a table: four significant digits, with thousands separators for large and whole numbers."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "–"
    if isinstance(value, float):
        if math.isinf(value):
            return "∞" if value > 0 else "-∞"
        if value.is_integer() and abs(value) >= 10_000:
            return f"{int(value):,}"
        return f"{value:.4g}" if abs(value) < 10_000 else f"{value:,.0f}"
    if isinstance(value, int) and not isinstance(value, bool):
        return f"{value:,}"
    return " ".join(str(value).split("\n")).replace("|", "\\|")


def format_value(value: object) -> str:
    """Format a value of a run: numbers with three significant digits, whole ones in full.

    Trailing zeros count as digits, so that a column is equally precise in each row: 0.900 beside 0.601.
    """
    if isinstance(value, str) or value is pd.NA:
        return "–" if value is pd.NA else str(value)
    if not isinstance(value, float) or not math.isfinite(value):
        return cell(value)
    if abs(value) >= _COUNTABLE:
        return f"{value:.3g}"
    rounded = value + 0.0 if value.is_integer() else float(f"{value:.3g}")  # -0.0 + 0.0 is 0.0
    if abs(rounded) >= 10_000:
        return f"{rounded:,.0f}"
    return f"{rounded:.0f}" if value.is_integer() or abs(rounded) >= 1_000 else padded_digits(value)


def escape(text: str) -> str:
    """Escape the markup in foreign text: links, images, HTML, code, emphasis."""
    return re.sub(r"[\\`*\[\]]", r"\\\g<0>", text).replace("&", "&amp;").replace("<", "&lt;")


def change(ours: float, theirs: float) -> str:
    """The relative difference of our number from theirs, in percent."""
    if math.isnan(ours) or not theirs:
        return "–"
    return f"{100 * (ours - theirs) / theirs:+.0f} %"


def three_digits(value: float) -> str:
    """Format with three significant digits, and without an exponent up to a million: 1840 and not 1.84e+03."""
    return f"{float(f'{value:.3g}'):g}"


def padded_digits(value: float) -> str:
    """Format with three significant digits, zeros too, for columns: 3.00 above 2.87."""
    text = f"{value:#.3g}"
    return three_digits(value) if "e" in text else text.rstrip(".")


def notes(run: RunResult) -> list[str]:
    """A sentence for each note on calibrations and sequences, each caveat of a headline, and each note on settings."""
    return [*calibration_notes(run), *sequence_notes(run), *caveats(run), *setting_notes(run)]


def calibration_notes(run: RunResult) -> list[str]:
    """Notes on each sequence that a run has under several calibrations.

    They name the calibrations that do not count in the answer, their effect on the baseline, and the settings whose
    order against it is reversed."""
    return [note for calibrated in calibrations(run) for note in _notes_on(calibrated)]


def _notes_on(calibrated: Calibrations) -> Iterator[str]:
    raw, by = calibrated.baseline, calibrated.column.label
    first = f"{', '.join(calibrated.others)}: {calibrated.sequence} under another calibration, excluded from answers"
    if calibrated.medians:
        medians = (f"{_against(calibrated.column, value)} on {name}" for name, value in calibrated.medians.items())
        first += f"; {by} of {raw}: {', '.join(medians)}"
    yield f"{first}."
    reversals = [orders for orders in calibrated.settings if orders.is_reversed]
    for orders in reversals[:_TURNING]:
        better, worse = (
            " and ".join(f"{name} ({_against(calibrated.column, *both)})" for name, both in medians.items())
            for medians in (orders.better, orders.worse)
        )
        yield (
            f"{calibrated.sequence}: {orders.setting} is better than {raw} by {by} on {better}, and worse on {worse}: "
            "the calibration decides their order."
        )
    if len(reversals) > _TURNING:
        more = counted(len(reversals) - _TURNING, "more setting")
        yield f"{calibrated.sequence}: the calibration also decides the order of {more}."
    comparable = sum(orders.is_comparable for orders in calibrated.settings)
    if comparable and not reversals:
        several = f"{comparable} of {counted(len(calibrated.settings), 'setting')}"
        none_turns = f"no order of {raw} and a setting is reversed"
        yield f"{calibrated.sequence}: {none_turns} (known for {several} under two or more calibrations)."
    elif calibrated.settings and not reversals:
        yield (
            f"{calibrated.sequence}: no setting differs from {raw} under two calibrations by more than the "
            "scatter over start offsets, so no order can be compared."
        )


def _against(column: Column, *values: float) -> str:
    """`8.9 against 13 m`."""
    numbers = " against ".join(three_digits(column.factor * value) for value in values)
    return numbers if column.unit in ("", "1") else f"{numbers} {column.unit}"


def sequence_notes(run: RunResult) -> list[str]:
    """A sentence for each note, with its sequences: how frames were converted, how many of them are used."""
    noted: dict[str, list[str]] = defaultdict(list)
    for entry in run.plan.sequences:
        for note in entry.notes:
            noted[note].append(entry.name)
    return [f"{', '.join(names)}: {note}." for note, names in noted.items()]


def caveats(run: RunResult, evaluators: Collection[str] | None = None) -> list[str]:
    """A sentence for each caveat of a headline, of all evaluators or of those with these names or titles."""
    columns = [
        column
        for column in run.headlines()
        if evaluators is None or column.evaluator.name in evaluators or column.evaluator.title in evaluators
    ]
    return list(dict.fromkeys(f"{column.label}: {column.metric.caveat}." for column in columns if column.metric.caveat))


def setting_notes(run: RunResult) -> list[str]:
    """A sentence for each note of a curve, with its settings that have the note if not all have it."""
    points: dict[str, set[str]] = defaultdict(set)
    noted: dict[tuple[str, str], dict[str, None]] = defaultdict(dict)
    for result in run.results:
        place = run.curves[result.cell.codec.name, result.cell.codec.label]
        points[place.curve].add(place.point)
        for note in result.notes:
            noted[place.curve, note][place.point] = None
    return [
        f"{curve}: {note}." if settings.keys() == points[curve] else f"{curve}, {', '.join(settings)}: {note}."
        for (curve, note), settings in noted.items()
    ]
