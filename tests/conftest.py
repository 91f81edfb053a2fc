"""Fixtures and options that every test folder shares."""

from __future__ import annotations

import gc
import os
import signal
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

settings.register_profile("shared machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("shared machine")

with pytest.MonkeyPatch.context() as environment:  # one thread in each of the processes that share the cores
    environment.setenv("OPENBLAS_NUM_THREADS", "1")
    import numpy as np
    import scipy.linalg  # noqa: F401  # has an OpenBLAS of its own

TIERS = ("thorough", "slow")
"""Marks of tests that take longer, and options that run them: a tier's option runs those of the shorter tiers too."""

LONGEST = (
    "test_codecs.py",
    "test_end_to_end.py",
    "test_whole_run.py",
    "test_zoo.py",
    "test_foreign_folder.py",
    "test_exit_statuses.py",
    "test_cli.py",
)
"""Files that begin first, so that no process is left alone with one of them in the end."""


def pytest_addoption(parser: pytest.Parser) -> None:
    for tier in TIERS:
        parser.addoption(f"--{tier}", action="store_true", help=f"also run the tests marked {tier}")


def pytest_configure() -> None:
    """Commands that the tests start can be interrupted, also where a shell started pytest in the background."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Whole folders are tested in several processes; single files, and benchmarks, in this one."""
    paths = [Path(str(argument).split("::")[0]) for argument in config.args]
    alone = any(not path.is_dir() or "benchmarks" in path.parts for path in paths)
    return 0 if alone else min(4, os.cpu_count() or 1)  # one more each would only collect the tests once more


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deselect the tests of tiers that were not asked for, so that a skip means that something is missing.

    What needs real sequences or other people's tools is thorough: the quick tier asks for nothing but the install. One
    test of it asks for the folder late, and is skipped without it.
    """
    asked = [place for place, tier in enumerate(TIERS) if config.getoption(f"--{tier}")]
    left_out = TIERS[max(asked) + 1 :] if asked else TIERS
    chosen, rest = [], []
    for item in items:
        if "data_folder" in getattr(item, "fixturenames", ()) and "benchmarks" not in item.path.parts:
            item.add_marker(pytest.mark.thorough)
        (rest if any(item.get_closest_marker(tier) for tier in left_out) else chosen).append(item)
    chosen.sort(key=lambda item: item.path.name not in LONGEST)
    items[:] = chosen
    config.hook.pytest_deselected(items=rest)


def pytest_collection_finish() -> None:
    """What was imported stays: no garbage collection has to look through all of it again."""
    gc.freeze()


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """The folder of real sequences; a test that asks for it is skipped where there is none."""
    value = os.environ.get("CODECBENCH_DATA")
    if not value:
        pytest.skip("CODECBENCH_DATA is not set: no real sequences to read")
    folder = Path(value)
    if not folder.is_dir():
        pytest.fail(f"CODECBENCH_DATA names {folder}, which is not a folder")
    return folder


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20240607)
