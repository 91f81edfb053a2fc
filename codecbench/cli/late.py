"""Modules that load at their first use, so that help and `codecbench list` are quick.

Loading all that commands need takes a second; help takes a tenth of that. So a command's module imports the modules
listed here as modules, `from codecbench.core.report import tables`, and Python executes them when a name of theirs is
first used. `from codecbench.core.report.tables import change` would execute the module at once. scipy loads its
parts (`scipy.stats` takes 1.5 s) in the same way by itself.

Before Python 3.12, `LazyLoader` has no lock: the main thread of a command uses a module before its other threads do.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import LazyLoader
from types import ModuleType
from typing import Final

LATE: Final = frozenset((
    "codecbench.cli.display",
    "codecbench.cli.examples",
    "codecbench.cli.show",
    "codecbench.core.analysis.choosing",
    "codecbench.core.analysis.collect",
    "codecbench.core.analysis.comparison",
    "codecbench.core.analysis.table",
    "codecbench.core.analysis.verification",
    "codecbench.core.conformance.settings",
    "codecbench.core.contracts.recipe",
    "codecbench.core.engine.bundling.packing",
    "codecbench.core.engine.hosting.confinement",
    "codecbench.core.engine.hosting.host",
    "codecbench.core.engine.planning.estimate",
    "codecbench.core.engine.planning.matrix",
    "codecbench.core.engine.planning.plan",
    "codecbench.core.engine.planning.schema",
    "codecbench.core.engine.plugins.offers",
    "codecbench.core.engine.plugins.registry",
    "codecbench.core.engine.running.code_changes",
    "codecbench.core.engine.running.record_kernels",
    "codecbench.core.engine.running.resume",
    "codecbench.core.engine.running.warm_up",
    "codecbench.core.engine.running.work",
    "codecbench.core.engine.storage.atomic",
    "codecbench.core.engine.storage.bitstream_file",
    "codecbench.core.engine.storage.plan_file",
    "codecbench.core.engine.storage.store",
    "codecbench.core.engine.text",
    "codecbench.core.report.answers",
    "codecbench.core.report.choosing",
    "codecbench.core.report.costs",
    "codecbench.core.report.figures",
    "codecbench.core.report.formatting",
    "codecbench.core.report.page",
    "codecbench.core.report.picks",
    "codecbench.core.report.tables",
    "codecbench.core.report.views",
    "codecbench.core.rounds.running",
    "codecbench.exporting.cells",
    "codecbench.exporting.coded_run",
    "codecbench.exporting.tum_files",
    "codecbench.paper.page",
    "codecbench.plugins.codecs.video.codecs",
    "codecbench.plugins.codecs.video.muxing",
    "codecbench.plugins.datasets.catalog",
    "codecbench.trial.choosing",
    "codecbench.trial.trial",
))  # fmt: skip


class _LateFinder:
    """Import hook that finds the modules in `LATE` and leaves all others to the finders after it."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None = None, target: ModuleType | None = None) -> ModuleSpec | None:
        spec = PathFinder.find_spec(name, path, target) if name in LATE else None
        if spec is not None and spec.loader is not None:
            spec.loader = LazyLoader(spec.loader)
        return spec


sys.meta_path.insert(0, _LateFinder)
