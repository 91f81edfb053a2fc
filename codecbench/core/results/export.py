"""Tables in the formats that people and programs read."""

from __future__ import annotations

import difflib
import fnmatch
import io
import json
import math
from typing import TYPE_CHECKING, Any

import pandas as pd

from codecbench.core.contracts.errors import ParamsError
from codecbench.core.results.markdown import foreign_table
from codecbench.core.results.table import NOTES

if TYPE_CHECKING:
    from codecbench.core.results.columns import Column
    from codecbench.core.results.run_result import RunResult

_KEYS = ("sequence", "codec", "setting")
_FORMULA = ("=", "+", "-", "@")
_LATEX = str.maketrans(
    {**{special: f"\\{special}" for special in "&%$#_{}"}, "\\": "\\textbackslash{}", "~": "\\textasciitilde{}",
     "^": "\\textasciicircum{}", "\n": " "}
)  # fmt: skip


def exported(frame: pd.DataFrame, format_: str) -> bytes:
    """A table as the bytes of a file: `csv`, `parquet`, `json`, `markdown` or `latex`.

    Numbers keep their full precision in csv, parquet and json; infinities are `inf`, missing values empty. In csv a
    text that spreadsheets would take for a formula gets an apostrophe before it.
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
    rows = _objects(frame).to_numpy().tolist()
    if format_ == "markdown":
        return foreign_table([str(name) for name in frame.columns], rows).encode()
    if format_ == "latex":
        return _latex(frame).encode()
    raise ParamsError(f"format {format_!r} is not one of csv, parquet, json, markdown, latex")


def chosen_columns(frame: pd.DataFrame, patterns: str) -> pd.DataFrame:
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
    heads = [column.brief if brief else column.heading for column in headlines]
    at = 0 if brief and (run.wide["status"] != "ok").any() else len(parts)
    table = pd.concat([run.wide[[*_KEYS]], *parts[:at], run.wide["status"], *parts[at:]], axis=1)
    table.columns = pd.Index([*_KEYS, *heads[:at], "status", *heads[at:]])
    return table


def _judged_by(run: RunResult) -> list[Column]:
    """The rate, whether the first task succeeds, and what is compared."""
    from codecbench.core.results.answers import judged_column
    from codecbench.core.results.ranking.words import successes

    succeeded = next(iter(successes(run)), [])
    return [column for column in (run.rate, *succeeded, judged_column(run)) if column is not None]


def _objects(frame: pd.DataFrame) -> pd.DataFrame:
    """The table with None for whatever is missing."""
    return frame.astype(object).where(frame.notna(), None)


def json_value(value: object) -> object:
    """A value that JSON can hold: infinities as text, NaN as null."""
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else ("inf" if value > 0 else "-inf")
    return value


def _no_formulas(frame: pd.DataFrame) -> pd.DataFrame:
    """The table with an apostrophe before each text, heads too, that begins like a formula; numbers as they are."""
    texts = [name for name in frame.columns if not pd.api.types.is_numeric_dtype(frame[name].dtype)]
    return frame.assign(**{name: frame[name].map(_no_formula) for name in texts}).rename(columns=_no_formula)


def _no_formula(value: Any) -> Any:
    return f"'{value}" if isinstance(value, str) and value.startswith(_FORMULA) else value


def _latex(frame: pd.DataFrame) -> str:
    """A booktabs table; pandas would want jinja2's styler for less control."""
    numeric = [pd.api.types.is_numeric_dtype(kind) for kind in frame.dtypes]
    lines = ["\\begin{tabular}{" + "".join("r" if is_number else "l" for is_number in numeric) + "}", "\\toprule"]
    lines.append(" & ".join(str(name).translate(_LATEX) for name in frame.columns) + " \\\\")
    lines.append("\\midrule")
    lines += [" & ".join(map(_latex_cell, row)) + " \\\\" for row in _objects(frame).to_numpy().tolist()]
    return "\n".join([*lines, "\\bottomrule", "\\end{tabular}"]) + "\n"


def _latex_cell(value: object) -> str:
    if value is None:
        return "--"
    if isinstance(value, float):
        return "$\\infty$" if value == float("inf") else f"{value:.4g}"
    return str(value).translate(_LATEX)
