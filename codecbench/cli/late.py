"""Loading of modules at their first use, so that help and `codecbench list` are quick.

A command imports the modules that it needs at its top, as modules: `from codecbench.core.report import tables`. Those
named here are executed when one of their names is first used. Loading all of them takes a second, help a tenth of it.
`from codecbench.core.report.tables import shown` uses a name and loads the module at once.
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
    "codecbench.cli.screen",
    "codecbench.cli.show",
    "codecbench.core.analysis.choosing",
    "codecbench.core.analysis.collect",
    "codecbench.core.analysis.comparison",
    "codecbench.core.analysis.table",
    "codecbench.core.analysis.verification",
    "codecbench.core.conformance.settings",
    "codecbench.core.contracts.recipe",
    "codecbench.core.engine.bundling.packing",
    "codecbench.core.engine.bundling.unpacking",
    "codecbench.core.engine.hosting.confinement",
    "codecbench.core.engine.planning.estimate",
    "codecbench.core.engine.planning.matrix",
    "codecbench.core.engine.planning.plan",
    "codecbench.core.engine.planning.schema",
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
    "codecbench.core.report.answers",
    "codecbench.core.report.choosing",
    "codecbench.core.report.costs",
    "codecbench.core.report.figures",
    "codecbench.core.report.formatting",
    "codecbench.core.report.page",
    "codecbench.core.report.pasting",
    "codecbench.core.report.tables",
    "codecbench.core.report.views",
    "codecbench.core.rounds.running",
    "codecbench.paper.page",
    "codecbench.plugins.codecs.video.codecs",
    "codecbench.plugins.codecs.video.muxing",
    "codecbench.plugins.datasets.catalog",
    "codecbench.trial.choosing",
    "codecbench.trial.example_files",
    "codecbench.trial.link_matrix",
    "codecbench.trial.trial",
))  # fmt: skip


class _LateFinder:
    """Finds the modules of `LATE`; all others are left to the finders behind it."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None = None, target: ModuleType | None = None) -> ModuleSpec | None:
        spec = PathFinder.find_spec(name, path, target) if name in LATE else None
        if spec is not None and spec.loader is not None:
            spec.loader = LazyLoader(spec.loader)
        return spec


sys.meta_path.insert(0, _LateFinder)
