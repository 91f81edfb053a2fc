"""Whatever an exception or an exit status is, there are words for it."""

from __future__ import annotations

import pytest

from codecbench.core.engine.text import describe_error, describe_exit


class Untold(Exception):
    def __str__(self) -> str:
        raise SystemExit("no words")


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (ValueError("no such table"), "ValueError: no such table"),
        (KeyboardInterrupt(), "KeyboardInterrupt: "),
        (Untold(), "Untold, whose message raises SystemExit"),
    ],
)
def test_an_exception_is_told(error: BaseException, words: str) -> None:
    assert describe_error(error) == words


@pytest.mark.parametrize(
    ("status", "words"),
    [
        (0, "it ended its process with status 0"),
        (3, "it ended its process with status 3"),
        (-9, "it ended its process by SIGKILL"),
        (-50, "it ended its process by signal 50"),
    ],
)
def test_an_end_is_told(status: int, words: str) -> None:
    assert describe_exit(status) == words
