"""Metrics: quantities with a unit, a direction, and a role in rankings and charts."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Final, Literal, get_args

from codecbench.core.contracts.errors import PluginError, former_names, require_choice

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
"""Ways to summarize many values by one; docs/results.md defines each."""

FRESH_S: Final = 0.5
"""Greatest age in seconds of a pose that a robot can still act on."""


@former_names(need="quantity", brief="column_header")
@dataclass(frozen=True)
class Metric:
    """A quantity that an evaluator measures."""

    name: str
    """As in tables and files; ends in its unit if it has one (`psnr_gray_db`)."""
    unit: str
    """Unit of the values: `dB`, `bytes`, or `1` for pure numbers."""
    better: Better
    """Direction that a codec author wants; `neither` if there is none."""
    summary: str
    """What it measures, in one sentence."""
    aggregates: tuple[str, ...] = ("mean",)
    """How the wide table summarizes it over frames and repeats; short tables and figures use the first."""
    repeatable: bool = True
    """Equal code on equal input gives equal values; False for times, which are compared statistically."""
    _: KW_ONLY
    role: Role = "behaviour"
    """What it means in a ranking.

    `rate`: what a codec spends. `quality`: how close decoded frames are to the originals. `task`: how well a task that
    reads them performs. `time`, `operations`: the cost of coding. `success`: 1 if a run succeeds, else 0. `behaviour`:
    descriptive only; it ranks nothing."""
    headline: bool = False
    """Whether it is a primary metric: shown first and used, by its role, in Pareto fronts, rankings and curves."""
    label: str = ""
    """Name for readers (`PSNR`); by default made from `name`."""
    column_header: str = ""
    """Narrow column header, which may have several lines; by default the label."""
    scale: Scale = "linear"
    """Scale of its axis."""
    display_unit: str = ""
    """Unit that readers see; by default `unit`."""
    display_factor: float = 1.0
    """Factor from `unit` to `display_unit`."""
    confirmed_by: str = ""
    """Another metric of the evaluator that must move the same way before a change is claimed."""
    in_units_of: str = ""
    """Another metric, timed beside this one; their ratio compares two runs whatever the machine's speed."""
    shown_with: str = ""
    """Another metric of the evaluator, shown beside each value that is judged by this one."""
    caveat: str = ""
    """What readers must know beside every value; printed below the tables that show the metric."""
    quantity: Quantity = ""
    """What the metric is for tools that look it up, whichever evaluator measures it.

    `codecbench choose` judges by a frame's `delay` (missing if it never arrived); the `error` of the task, and that of
    a task that gets no frames (`idle`); the share of moments with a pose of the last FRESH_S (`fresh`); and each
    `cause` of missed deadlines with its share of frames. Evaluators may require the times in milliseconds of
    `encoding`, `decoding` and `reading` a frame (`Evaluator.requires`). If all qualities in dB of a row are infinite,
    its bits `per_pixel` and how many percent it is `below_png` tell tables whether that is plausible."""
    enough: float | None = None
    """A setting passes if its mean is on the right side of this bound at 95 %.

    Without one the bound is 0.8 times the raw frames' value, or twice that value if lower is better. A task metric that
    has one must pass beside the success metric."""

    def __post_init__(self) -> None:
        where = f"metric {self.name!r}"
        require_choice(f"{where}: better", self.better, Better)
        require_choice(f"{where}: role", self.role, Role)
        require_choice(f"{where}: scale", self.scale, Scale)
        require_choice(f"{where}: quantity", self.quantity, Quantity)
        if isinstance(self.aggregates, str) or not self.aggregates:
            raise PluginError(f"{where}: aggregates is {self.aggregates!r}; it must be a tuple of names")
        for how in self.aggregates:
            require_choice(f"{where}: aggregate", how, Aggregate)
        object.__setattr__(self, "label", self.label or self._plain_name())
        object.__setattr__(self, "column_header", self.column_header or self.label)
        object.__setattr__(self, "display_unit", self.display_unit or self.unit)

    def _plain_name(self) -> str:
        """Return the name in words, without the unit at its end."""
        words = self.name.split("_")
        if len(words) > 1 and words[-1].lower() == self.unit.lower():
            words = words[:-1]
        return " ".join(words)
