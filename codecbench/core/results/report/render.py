"""Puts the page together."""

from __future__ import annotations

import json
from collections.abc import Callable
from importlib.metadata import version
from importlib.resources import files
from typing import Any, Final

import jinja2
import numpy as np
import pandas as pd
import plotly.offline

from codecbench.core.engine.planning.matrix import VERSION as MATRIX_VERSION
from codecbench.core.results.bjontegaard import BdRate
from codecbench.core.results.report import page_data
from codecbench.core.results.run_result import RunResult
from codecbench.core.results.table import shown
from codecbench.core.results.verdicts import (
    Limit,
    anchor_of,
    bd_rates,
    pareto_settings,
    spread,
    trajectory_bd_rates,
    trajectory_limits,
)

SIZE_LIMIT_BYTES: Final = 8_000_000
"""What the page should weigh: pictures of frames take what is left of it, those of settings beyond are left out."""

_REST_BYTES: Final = 150_000
"""Kept for the page's text, style and script, and for what is said of failures."""

_HEADS: Final = ("curve", "settings", "Pareto front", "rate [bpp]", "PSNR gray [dB]", "BD-rate, PSNR", "BD-rate, SSIM",
                 "BD-rate, features", "BD-rate, trajectory", "tracking holds down to",
                 "encode [ms]", "decode [ms]")  # fmt: skip


def render(run: RunResult, frames: Callable[[int], dict[str, Any]], trajectories: list[dict[str, Any]]) -> str:
    """The page as HTML text.

    frames: given how many bytes they may take, gives `frames` and `originals` as the script takes them. trajectories:
    one entry a trajectory.
    """
    known = page_data.columns(run.wide, run.results)
    data = {
        "name": run.plan.name,
        "table": page_data.table(run.wide, run.curves),
        "columns": known,
        "sequences": [entry.name for entry in run.plan.sequences],
        "presets": page_data.presets(known),
        "intervals": page_data.intervals(run.wide),
        "brief": page_data.brief(known),
        "operations": page_data.operations(run.wide),
        "trajectories": trajectories,
    }
    parts = files("codecbench.core.results.report")
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    template = environment.from_string((parts / "page.html.j2").read_text(encoding="utf-8"))
    verdicts, anchor = _verdicts(run)
    plotly_script = plotly.offline.get_plotlyjs()
    spent_bytes = len(plotly_script.encode()) + len(_script_json(data).encode()) + len(run.plan.matrix_text.encode())
    data |= frames(SIZE_LIMIT_BYTES - _REST_BYTES - spent_bytes)
    return template.render(
        name=run.plan.name,
        subtitle=_subtitle(run),
        css=_trusted((parts / "page.css").read_text(encoding="utf-8")),
        script=_trusted((parts / "page.js").read_text(encoding="utf-8")),
        plotly=_trusted(plotly_script),
        data=_trusted(_script_json(data)),
        has={part: bool(data[part]) for part in ("trajectories", "frames", "operations")},
        cards=_cards(run),
        verdicts=verdicts,
        anchor=anchor,
        failures=_failures(run),
        environment=json.dumps(run.environments, indent=1, sort_keys=True),
        matrix=run.plan.matrix_text,
        folder=run.folder.name,
        version=version("codecbench"),
    )


def _script_json(value: Any) -> str:
    """JSON that cannot end the script element that holds it."""
    return json.dumps(value, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def _trusted(text: str) -> Any:
    import markupsafe

    return markupsafe.Markup(text)


def _subtitle(run: RunResult) -> str:
    sequences = ", ".join(f"{entry.name} ({entry.frames} frames)" for entry in run.plan.sequences)
    return f"codecbench run, matrix version {MATRIX_VERSION}, on {sequences}"


def _cards(run: RunResult) -> list[dict[str, str]]:
    done = sum(result.status == "ok" for result in run.results)
    failed, unsupported = len(run.failed), sum(result.status == "unsupported" for result in run.results)
    settings = {(result.cell.codec.name, result.cell.codec.label) for result in run.results}
    evaluators = sorted({shown(result.cell.evaluator) for result in run.results})
    cards = [
        {"title": "Cells computed", "value": f"{done} of {len(run.plan.cells)}", "tone": "good" if not failed else "",
         "note": f"{failed} failed, {unsupported} unsupported, {run.missing} not yet run"},
        {"title": "Codec settings", "value": str(len(settings)), "tone": "",
         "note": f"{len({codec for codec, _ in settings})} codecs on {len(run.plan.sequences)} sequences"},
        {"title": "Evaluators", "value": str(len(evaluators)), "tone": "", "note": ", ".join(evaluators)},
    ]  # fmt: skip
    known = {
        json.dumps(one.get("machine", {}), sort_keys=True): one.get("machine", {}) for one in run.environments.values()
    }
    machines = [str(machine.get("cpu") or "unknown processor") for machine in known.values()]
    several = f"{len(machines)} machines: do not compare times"
    note = "times hold for this machine alone" if len(machines) < 2 else several
    return [*cards, {"title": "Machine", "value": machines[0] if machines else "unknown", "tone": "", "note": note}]


def _verdicts(run: RunResult) -> tuple[list[dict[str, Any]], str]:
    """One table a sequence, one row a curve, and the name of the anchor."""
    quality, features = run.of("quality"), run.of("features")
    rates = [
        bd_rates(quality, quality, run.curves, "psnr_gray_db"),
        bd_rates(quality, quality, run.curves, "ssim_matlab"),
        bd_rates(quality, features, run.curves, "keypoint_repeatability"),
        trajectory_bd_rates(run.wide, _of_first_evaluator(run.tidy, "ate_rmse_m"), run.curves),
    ]
    success = _of_first_evaluator(run.tidy, "success")
    limits = trajectory_limits(run.wide, success, run.curves) if len(success) else {}
    tables, anchor = [], ""
    for entry in run.plan.sequences:
        wide = run.wide[run.wide["sequence"] == entry.name]
        criteria, front = pareto_settings(wide)
        curves: dict[str, list[Any]] = {}
        for record, leads in zip(wide.to_dict("records"), front, strict=True):
            curve = run.curves[record["codec"], record["setting"]].curve
            curves.setdefault(curve, []).append({**record, _LEADS: leads})
        anchor = anchor_of(curves) or anchor
        rows = []
        for curve, records in curves.items():
            key = (entry.name, curve)
            rows.append(
                [
                    curve, str(len(records)), f"{sum(record[_LEADS] for record in records)} of {len(records)}",
                    _range(records, "quality.rate_bpp.mean"), _range(records, "quality.psnr_gray_db.mean"),
                    *("anchor" if curve == anchor else str(found.get(key, "–")) for found in rates),
                    _limit(limits[key]) if key in limits else "–",
                    *(spread(_values(records, f"timing.{way}_cpu_ms.median")) for way in ("encode", "decode")),
                ]
            )  # fmt: skip
        note = f"Pareto front: settings that no other beats in all of {', '.join(criteria)}." if criteria else ""
        words = _in_words(entry.name, anchor, dict(zip(_EQUAL, rates, strict=True)), limits)
        tables.append({"sequence": entry.name, "heads": _HEADS, "rows": rows, "note": note, "words": words})
    return tables, anchor


_LEADS: Final = "on the Pareto front"
_EQUAL: Final = ("PSNR", "SSIM", "features kept", "trajectory error")
"""What the BD-rates hold equal, in the order of their columns."""


def _in_words(
    sequence: str,
    anchor: str,
    rates: dict[str, dict[tuple[str, str], BdRate]],
    limits: dict[tuple[str, str], Limit | None],
) -> list[str]:
    """Who needs least rate on a sequence, for each thing held equal, and who tracks down to the least."""
    words = []
    for equal, found in rates.items():
        here = {curve: rate for (name, curve), rate in found.items() if name == sequence and not rate.reason}
        if here:
            best = min(here, key=lambda curve: here[curve].percent)
            ahead = here[best].percent < 0.0
            text = f"{best} needs least rate: {here[best]} against {anchor}" if ahead else f"{anchor} needs least rate"
            words.append(f"At equal {equal}, {text}.")
    held = {curve: limit for (name, curve), limit in limits.items() if name == sequence and limit is not None}
    if held:
        least = min(held, key=lambda curve: held[curve].rate_bpp)
        words.append(f"Tracking holds down to the least rate with {least}: {_limit(held[least])}.")
    return words


def _of_first_evaluator(tidy: pd.DataFrame, metric: str) -> pd.DataFrame:
    """Rows of a metric of the trajectory, under the first setting of the evaluator where there are several."""
    rows = tidy[tidy["metric"] == metric]
    return rows[rows["evaluator"] == rows["evaluator"].iloc[0]] if len(rows) else rows


def _values(records: list[Any], column: str) -> np.ndarray:
    return np.array([float(record.get(column, np.nan)) for record in records])


def _range(records: list[Any], column: str) -> str:
    values = _values(records, column)
    values = values[~np.isnan(values)]
    if not len(values):
        return "–"
    low, high = values.min(), values.max()
    text = f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
    return text.replace("inf", "∞")


def _limit(limit: Limit | None) -> str:
    if limit is None:
        return "fails at every setting"
    text = f"{limit.point or 'its setting'} ({limit.rate_bpp:.3g} bpp, {limit.successes}/{limit.runs} runs"
    text += f", at least {100 * limit.low:.0f} % at 95 %)"
    return text + (f"; {limit.next_failing} fails" if limit.next_failing else "; never failed here")


def _failures(run: RunResult) -> list[list[str]]:
    return [
        [
            r.cell.sequence.name,
            r.cell.codec.name,
            r.cell.codec.label,
            shown(r.cell.evaluator),
            r.status,
            r.reason,
            r.cell.id[:12],
        ]
        for r in run.results
        if r.status != "ok"
    ]
