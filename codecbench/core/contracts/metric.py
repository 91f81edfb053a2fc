"""What a metric is: a quantity with a unit, a direction, and what it means to those who rank and draw."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Final, Literal, get_args

from codecbench.core.contracts.errors import PluginError, require_choice
from codecbench.core.contracts.former_names import former_names

Better = Literal["higher", "lower", "neither"]
Role = Literal["rate", "quality", "task", "time", "operations", "behaviour", "success"]
Scale = Literal["linear", "log"]
Quantity = Literal[
    "", "delay", "error", "idle", "fresh", "cause", "encoding", "decoding", "reading", "per_pixel", "below_png"
]  # fmt: skip
Aggregate = Literal[
    "mean", "std", "median", "p95", "iqr", "min", "max", "sum", "infinite", "ci95_low", "ci95_high"
]  # fmt: skip

AGGREGATES: Final[tuple[Aggregate, ...]] = get_args(Aggregate)
"""How many values may become one; docs/results.md defines each."""

FRESH_S: Final = 0.5
"""How old a pose may be, in seconds, that a robot can still act by."""


@former_names(need="quantity", brief="column_header")
@dataclass(frozen=True)
class Metric:
    """A quantity that an evaluator measures.

    name: ends in its unit where it has one (`psnr_gray_db`). unit: `dB`, `bytes`, `1` for pure numbers.
    better: which direction a codec author wants, `neither` where there is none.
    aggregates: how the wide table summarises it over frames and repeats, the first for short tables and figures.
    repeatable: equal code on equal input gives equal values; False for times, which are compared statistically.

    role: what it means to a ranking. `rate` is what a codec spends; `quality` what is left of the images; `task`
    how well something that reads them does; `time` and `operations` what coding takes; `success` is 1 where a run
    succeeds and 0 where not; `behaviour` describes and ranks nothing.
    headline: shown first, and by its role in Pareto fronts, rankings and curves.
    label: for people ("PSNR"), by default made from the name. column_header: a narrow column head, which
    may have several lines, by default the label.
    scale: of its axis. display_unit, display_factor: what people are shown in place of `unit`, where that is unwieldy.

    confirmed_by: another metric of the evaluator that must move the same way before a change is claimed.
    in_units_of: another metric, timed beside this one, by which two runs are compared whatever the machine's pace.
    enough: a setting passes if its mean is on the right side of this value at 95 %. Without one the bound is 0.8 times
    the raw frames' value, or twice it if lower is better. A task that has one is asked for beside a success.
    caveat: what a reader must know beside every number of it; it stands below the tables that show the metric.
    quantity: what others look for in it, whichever evaluator measures it. `codecbench choose` judges by a frame's
    `delay`, missing if it never came; by the `error` of what reads the frames, beside that of one that gets none
    (`idle`); by the share of the moments at which that knows a pose of the last FRESH_S (`fresh`); and by the `cause`
    for which a share of the frames did not come in time. The times, in milliseconds, of `encoding`, `decoding` and
    `reading` a frame are for evaluators that require them (`Evaluator.requires`). By a frame's bits `per_pixel`, and by
    how many percent it is `below_png`, tables recognize an implausible lossless row, one of which every quality in dB
    is infinite.
    """

    name: str
    unit: str
    better: Better
    summary: str
    aggregates: tuple[str, ...] = ("mean",)
    repeatable: bool = True
    _: KW_ONLY
    role: Role = "behaviour"
    headline: bool = False
    label: str = ""
    column_header: str = ""
    scale: Scale = "linear"
    display_unit: str = ""
    display_factor: float = 1.0
    confirmed_by: str = ""
    in_units_of: str = ""
    caveat: str = ""
    quantity: Quantity = ""
    enough: float | None = None

    def __post_init__(self) -> None:
        where = f"metric {self.name!r}"
        require_choice(f"{where}: better", self.better, Better)
        require_choice(f"{where}: role", self.role, Role)
        require_choice(f"{where}: scale", self.scale, Scale)
        require_choice(f"{where}: quantity", self.quantity, Quantity)
        if isinstance(self.aggregates, str) or not self.aggregates:
            raise PluginError(f"{where}: aggregates is {self.aggregates!r}; it is a tuple of names")
        for how in self.aggregates:
            require_choice(f"{where}: aggregate", how, Aggregate)
        object.__setattr__(self, "label", self.label or self._plain_name())
        object.__setattr__(self, "column_header", self.column_header or self.label)
        object.__setattr__(self, "display_unit", self.display_unit or self.unit)

    @property
    def heading(self) -> str:
        """The label with the unit that people are shown: `PSNR [dB]`."""
        return f"{self.label} [{self.display_unit}]" if self.display_unit not in ("", "1") else self.label

    def _plain_name(self) -> str:
        """The name in words, without the unit at its end."""
        words = self.name.split("_")
        if len(words) > 1 and words[-1].lower() == self.unit.lower():
            words = words[:-1]
        return " ".join(words)
