"""Whether more than half of all runs succeed, judged after every few runs without being wrong more often for it.

A 95 % interval that is looked at again and again excludes the truth sooner or later. So a verdict that ends the runs
early takes more: the likelihood of what was seen, mixed over all success rates, must be twenty times that at one half.
If the rate is one half, that ever happens with a chance of at most 1/20, however often one looks (Ville 1939; Robbins,
Annals of Mathematical Statistics 41(5), 1970, doi:10.1214/aoms/1177696786). Once all runs that may be spent are spent,
the interval decides as it does for any run.
"""

from __future__ import annotations

import math
from typing import Final

from codecbench.core.results.limits import HOLDS_ABOVE, Holding, Standing

CHANCE: Final = 0.05
"""That runs whose success rate is HOLDS_ABOVE are ever said to hold, or to fail, before all are spent."""
FEWEST: Final = 4
"""Runs below which no interval lies on one side of HOLDS_ABOVE."""


def stands(successes: int, runs: int) -> bool:
    """Whether the verdict on so many runs would stand whatever comes after them."""
    from scipy.special import betaln  # loads for a quarter of a second, and few runs are added to

    mixed = float(betaln(successes + 1, runs - successes + 1))
    at_limit = successes * math.log(HOLDS_ABOVE) + (runs - successes) * math.log(1.0 - HOLDS_ABOVE)
    return mixed - at_limit >= -math.log(CHANCE)


def verdict(successes: int, runs: int, most: int) -> Holding:
    """What so many of at most `most` runs say; `cannot tell` while more of them are to come or would be needed."""
    if stands(successes, runs):
        return "holds" if successes > HOLDS_ABOVE * runs else "fails"
    return Standing("", math.nan, successes, runs).verdict if 0 < most <= runs else "cannot tell"


def runs_to_make(successes: int, runs: int, most: int) -> int:
    """How many runs there are to be in all before the verdict is looked at again, at most `most`.

    As few as could decide, if all to come end as most have.
    """
    gained = int(successes >= HOLDS_ABOVE * runs)
    more = next(
        more for more in range(most + 1) if runs + more >= most or stands(successes + gained * more, runs + more)
    )
    return min(most, runs + max(more, 1))
