"""The log file of a run: one line for each thing worth knowing, appended run after run."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def logging_to(path: Path, level: int) -> Iterator[None]:
    """Write what codecbench logs to `path` meanwhile."""
    logger = logging.getLogger("codecbench")
    handler = _LogFile(path, encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    handler.setLevel(level)
    before = logger.level
    logger.addHandler(handler)
    logger.setLevel(level)
    try:
        yield
    finally:
        logger.setLevel(before)
        logger.removeHandler(handler)
        with suppress(OSError):
            handler.close()


class _LogFile(logging.FileHandler):
    """A log whose lines are dropped where they cannot be written: a full disk is told by what cannot be recorded."""

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 - named by logging
        pass
