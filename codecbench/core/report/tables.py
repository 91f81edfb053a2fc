"""Tables in the formats that people and programs read."""

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
"""From here on numbers have exponents: floats are whole there whether they count or not."""
_FORMULA = ("=", "+", "-", "@")
_TURNING = 3
"""Settings whose order turns that are named before the rest is counted."""
_LATEX = str.maketrans(
    {**{special: f"\\{special}" for special in "&%$#_{}"}, "\\": "\\textbackslash{}", "~": "\\textasciitilde{}",
     "^": "\\textasciicircum{}", "\n": " "}
)  # fmt: skip
_LATEX_NUMBERS = {"–": "--", "∞": "$\\infty$", "-∞": "$-\\infty$"}


def export_table(frame: pd.DataFrame, format_: str, below: str = "") -> bytes:
    """A table as the bytes of a file: `csv`, `parquet`, `json`, `markdown` or `latex`.

    Numbers keep their full precision in csv, parquet and json; infinities are `inf`, missing values empty. In csv a
    text that spreadsheets would take for a formula gets an apostrophe before it. In markdown and latex numbers have
    three significant digits. below: a sentence that stands there below the table, in latex as a comment.
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
    """The identifying columns and those that match one of the comma-separated patterns, in the patterns' order.

    What is noted of settings stays too: numbers are not to be read without it.
    Raises ParamsError where a pattern matches nothing.
    """
    names = [str(name) for name in frame.columns]
    chosen = [name for name in _KEYS if name in names]
    for pattern in filter(None, (part.strip() for part in patterns.split(","))):
        found = [name for name in names if fnmatch.fnmatchcase(name, pattern)]
        if not found:
            near = difflib.get_close_matches(pattern, names, n=5, cutoff=0.3)
            raise ParamsError(f"no column matches {pattern!r}; near it: {', '.join(near) or 'none'}")
        chosen += [name for name in found if name not in chosen]
    chosen += [NOTES] if NOTES in names and NOTES not in chosen else []
    return frame[chosen]


def short_table(run: RunResult, *, brief: bool = False) -> pd.DataFrame:
    """The headlines of a run in the units that people are shown, under heads for people.

    brief: narrow heads, on several lines where there is more to say than the metric, for a screen that may not hold all
    columns beside each other: the rate and what codecs are judged by come first, before them the status where a row is
    not ok.
    """
    headlines = run.headlines()
    if brief:
        headlines = list(dict.fromkeys([*_judged_by(run), *headlines]))
    parts = [run.wide[column.name] * column.factor for column in headlines]
    heads = [column.short_heading if brief else column.heading for column in headlines]
    at = 0 if brief and (run.wide["status"] != "ok").any() else len(parts)
    table = pd.concat([run.wide[[*_KEYS]], *parts[:at], run.wide["status"], *parts[at:]], axis=1)
    table.columns = pd.Index([*_KEYS, *heads[:at], "status", *heads[at:]])
    return table


def drop_constant_columns(frame: pd.DataFrame) -> tuple[pd.DataFrame, str]:
    """The table without the columns that have one value in all of several rows, and a sentence that says those."""
    if len(frame) < 2:
        return frame, ""
    same = [frame.iloc[:, at].nunique(dropna=False) == 1 for at in range(frame.shape[1])]
    values = ((name, format_value(frame.iloc[0, at])) for at, name in enumerate(frame.columns) if same[at])
    told = [" ".join(f"{name} {value}".split()) for name, value in values if value]
    return frame.loc[:, [not one for one in same]], f"In all rows: {', '.join(told)}." if told else ""


def _judged_by(run: RunResult) -> list[Column]:
    """The rate, whether the first task succeeds, and what is compared."""
    succeeded = next(iter(successes(run)), [])
    return [column for column in (run.rate, *succeeded, judged_column(run)) if column is not None]


def _objects(frame: pd.DataFrame) -> pd.DataFrame:
    """The table with None for whatever is missing."""
    return frame.astype(object).where(frame.notna(), None)


def _no_formulas(frame: pd.DataFrame) -> pd.DataFrame:
    """The table with an apostrophe before each text, heads too, that begins like a formula; numbers as they are."""
    texts = [name for name in frame.columns if not pd.api.types.is_numeric_dtype(frame[name].dtype)]
    return frame.assign(**{name: frame[name].map(_no_formula) for name in texts}).rename(columns=_no_formula)


def _no_formula(value: Any) -> Any:
    return f"'{value}" if isinstance(value, str) and value.startswith(_FORMULA) else value


def _latex(frame: pd.DataFrame, rows: list[list[str]]) -> str:
    """A booktabs table; pandas would want jinja2's styler for less control."""
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
    """A Markdown table of text that others wrote: markup in it is escaped."""
    format_value = ([escape(value) if isinstance(value, str) else value for value in row] for row in rows)
    return table([escape(head) for head in heads], format_value)


def cell(value: object) -> str:
    """A value as a table shows it: four significant digits, thousands apart where it is a count."""
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
    """A value of a run for people: numbers with three significant digits, whole ones in full.

    Trailing zeros are digits too, so that a column tells as much in each row: 0.900 beside 0.601.
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
    """Foreign text that a page would otherwise take for markup: links, pictures, HTML, code, emphasis."""
    return re.sub(r"[\\`*\[\]]", r"\\\g<0>", text).replace("&", "&amp;").replace("<", "&lt;")


def change(ours: float, theirs: float) -> str:
    """How far our number is from theirs, in percent."""
    if math.isnan(ours) or not theirs:
        return "–"
    return f"{100 * (ours - theirs) / theirs:+.0f} %"


def three_digits(value: float) -> str:
    """With three significant digits, and without an exponent up to a million: 1840 and not 1.84e+03."""
    return f"{float(f'{value:.3g}'):g}"


def padded_digits(value: float) -> str:
    """With three significant digits, zeros too, for columns: 3.00 above 2.87."""
    text = f"{value:#.3g}"
    return three_digits(value) if "e" in text else text.rstrip(".")


def notes(run: RunResult) -> list[str]:
    """What calibrations decide, and a sentence for each note on a sequence, for each caveat of a headline, and for
    those on codec settings."""
    return [*calibration_notes(run), *sequence_notes(run), *caveats(run), *setting_notes(run)]


def calibration_notes(run: RunResult) -> list[str]:
    """Of each sequence that a run has under several calibrations: which of them do not count in the answer, what they
    do to the baseline, and settings whose order beside it turns, or that none is seen to."""
    return [note for each in calibrations(run) for note in _of_calibrations(each)]


def _of_calibrations(found: Calibrations) -> Iterator[str]:
    raw, by = found.baseline, found.column.label
    beside = f"{', '.join(found.others)}: {found.sequence} under another calibration, which no answer counts"
    if found.medians:
        medians = (f"{_shown(found.column, value)} on {name}" for name, value in found.medians.items())
        beside += f"; {by} of {raw}: {', '.join(medians)}"
    yield f"{beside}."
    turning = [orders for orders in found.settings if orders.is_reversed]
    for orders in turning[:_TURNING]:
        better, worse = (
            " and ".join(f"{name} ({_shown(found.column, *both)})" for name, both in medians.items())
            for medians in (orders.better, orders.worse)
        )
        yield (
            f"{found.sequence}: {orders.setting} is better than {raw} by {by} on {better}, and worse on {worse}: "
            "their order is within what this calibration can tell."
        )
    if len(turning) > _TURNING:
        yield f"{found.sequence}: so it is of {counted(len(turning) - _TURNING, 'more setting')}."
    told = sum(orders.is_comparable for orders in found.settings)
    if told and not turning:
        several = f"{told} of {counted(len(found.settings), 'setting')}"
        yield f"{found.sequence}: no order of {raw} and a setting turns, of {several} that have one under two or more."
    elif found.settings and not turning:
        yield (
            f"{found.sequence}: no setting has an order beside {raw} under two calibrations, beyond the scatter over "
            "starts, so that nothing tells whether one turns."
        )


def _shown(column: Column, *values: float) -> str:
    """`8.9 against 13 m`."""
    numbers = " against ".join(three_digits(column.factor * value) for value in values)
    return numbers if column.unit in ("", "1") else f"{numbers} {column.unit}"


def sequence_notes(run: RunResult) -> list[str]:
    """A sentence for each note, with the sequences that have it: what was done to frames, how many of them are used."""
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
    """A sentence for each note of a curve, with the settings of it that have the note where not all have."""
    points: dict[str, set[str]] = defaultdict(set)
    noted: dict[tuple[str, str], dict[str, None]] = defaultdict(dict)
    for result in run.results:
        place = run.curves[result.cell.codec.name, result.cell.codec.label]
        points[place.curve].add(place.point)
        for note in result.notes:
            noted[place.curve, note][place.point] = None
    return [
        f"{curve}: {note}." if found.keys() == points[curve] else f"{curve}, {', '.join(found)}: {note}."
        for (curve, note), found in noted.items()
    ]
