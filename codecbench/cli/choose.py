"""`codecbench choose`."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path

import click

from codecbench.cli.formats import Format
from codecbench.cli.rank import show_found


def quantity(units: Mapping[str, float]) -> Callable[[str], float]:
    """Reads a number with one of some units, as the first of them: `5cm` is 0.05 where that is the metre."""

    def quantity(text: str) -> float:
        found = re.fullmatch(r"(\d+\.?\d*|\.\d+)\s*([a-z]+)", text)
        if found is None or found[2] not in units or float(found[1]) <= 0:
            raise click.BadParameter(f"{text!r} is not a positive number with one of {', '.join(units)}")
        return float(found[1]) * units[found[2]]

    return quantity


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--link", required=True, metavar="LINK", help="The link over which pictures come.")
@click.option("--deadline", type=quantity({"ms": 1.0, "s": 1000.0}), metavar="TIME",
              help="The oldest that a picture may be when it is there, such as 100ms.")  # fmt: skip
@click.option("--error", type=quantity({"m": 1.0, "cm": 0.01, "mm": 0.001}), metavar="LENGTH",
              help="The largest error of what reads the pictures, such as 5cm.")  # fmt: skip
@click.option("--share", type=click.FloatRange(0, 1, min_open=True), default=0.95, show_default=True,
              help="Of the pictures that are to be there in time.")  # fmt: skip
@click.option("--device-factor", type=click.FloatRange(min=0, min_open=True), metavar="FACTOR",
              help="Count the time of encoding, on a device so many times slower than the one timed.")  # fmt: skip
@click.option("--format", "format_", type=Format(["text", "markdown", "json"]), default="text", show_default=True)
def choose(
    run: Path,
    link: str,
    deadline: float | None,
    error: float | None,
    share: float,
    device_factor: float | None,
    format_: str,
) -> None:
    """Say which settings of the RUN folder are good enough over a link, and what limits the others.

    They stand in order of rate, and the first that holds is the one to take. Of the deadline and the error at least one
    is given. A setting holds where more than half of all runs that there could be would succeed, at 95 %.
    """
    from codecbench.core.results.begun import begun_run
    from codecbench.core.results.choosing.candidates import Demand
    from codecbench.core.results.choosing.words import choices

    if deadline is None and error is None:
        raise click.UsageError("say what is asked: --deadline, --error or both")
    result = begun_run(run)
    show_found(result, choices(result, Demand(link, deadline, error, share, device_factor)), format_)
