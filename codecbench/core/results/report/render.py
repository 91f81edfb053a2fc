"""Puts the page together."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib.metadata import version
from importlib.resources import files
from typing import Any, Final

import jinja2
import numpy as np
import plotly.offline

from codecbench.core.engine.matrix import VERSION as MATRIX_VERSION
from codecbench.core.results.report import page_data
from codecbench.core.results.run_result import RunResult
from codecbench.core.results.table import shown
from codecbench.core.results.verdicts import Limit, anchor_of, bd_rates, spread, trajectory_limits

SIZE_LIMIT_BYTES: Final = 8_000_000
"""What the page may weigh; pictures of settings beyond it are left out, and the page says so."""

_HEADS: Final = ("curve", "settings", "rate [bpp]", "PSNR gray [dB]", "BD-rate, PSNR", "BD-rate, SSIM",
                 "tracking holds down to", "encode [ms]", "decode [ms]")  # fmt: skip


def render(run: RunResult, pictures: Mapping[str, Any]) -> str:
    """The page as HTML text.

    pictures: `frames` and `originals`, `trajectories`, as the script takes them; what cannot be drawn is empty.
    """
    known = page_data.columns(run.wide, run.results)
    data = {
        "name": run.plan.name,
        "rows": page_data.rows(run.wide, run.curves),
        "columns": known,
        "sequences": [entry.name for entry in run.plan.sequences],
        "presets": page_data.presets(known),
        "intervals": page_data.intervals(run.wide),
        "brief": page_data.brief(known),
        "operations": page_data.operations(run.wide),
        **pictures,
    }
    parts = files("codecbench.core.results.report")
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    template = environment.from_string((parts / "page.html.j2").read_text(encoding="utf-8"))
    verdicts, anchor = _verdicts(run)
    return template.render(
        name=run.plan.name,
        subtitle=_subtitle(run),
        css=_trusted((parts / "page.css").read_text(encoding="utf-8")),
        script=_trusted((parts / "page.js").read_text(encoding="utf-8")),
        plotly=_trusted(plotly.offline.get_plotlyjs()),
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
    return json.dumps(value, allow_nan=False).replace("<", "\\u003c")


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
    machines = [str(one.get("machine", {}).get("cpu") or "unknown processor") for one in run.environments.values()]
    several = f"{len(machines)} machines: do not compare times"
    note = "times hold for this machine alone" if len(machines) < 2 else several
    return [*cards, {"title": "Machine", "value": machines[0] if machines else "unknown", "tone": "", "note": note}]


def _verdicts(run: RunResult) -> tuple[list[dict[str, Any]], str]:
    """One table a sequence, one row a curve, and the name of the anchor."""
    quality = run.of("quality")
    psnr, ssim = (bd_rates(quality, run.curves, metric) for metric in ("psnr_gray_db", "ssim_matlab"))
    success = run.tidy[run.tidy["metric"] == "success"]
    limits = trajectory_limits(run.wide, success, run.curves) if len(success) else {}
    tables, anchor = [], ""
    for entry in run.plan.sequences:
        curves: dict[str, list[Any]] = {}
        for record in run.wide[run.wide["sequence"] == entry.name].to_dict("records"):
            curves.setdefault(run.curves[record["codec"], record["setting"]].curve, []).append(record)
        anchor = anchor_of(curves) or anchor
        rows = []
        for curve, records in curves.items():
            key = (entry.name, curve)
            rows.append(
                [
                    curve, str(len(records)), _range(records, "quality.rate_bpp.mean"),
                    _range(records, "quality.psnr_gray_db.mean"),
                    *("anchor" if curve == anchor else str(found.get(key, "–")) for found in (psnr, ssim)),
                    _limit(limits[key]) if key in limits else "–",
                    *(spread(_values(records, f"timing.{way}_wall_ms.median")) for way in ("encode", "decode")),
                ]
            )  # fmt: skip
        tables.append({"sequence": entry.name, "heads": _HEADS, "rows": rows})
    return tables, anchor


def _values(records: list[Any], column: str) -> np.ndarray:
    return np.array([float(record.get(column, np.nan)) for record in records])


def _range(records: list[Any], column: str) -> str:
    values = _values(records, column)
    values = values[~np.isnan(values)]
    if not len(values):
        return "–"
    low, high = values.min(), values.max()
    return f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"


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
