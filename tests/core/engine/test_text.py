"""Whatever an exception or an exit status is, there are words for it."""

from __future__ import annotations

import pytest

from codecbench.core.engine.text import describe_error, describe_exit


class Untold(Exception):
    def __str__(self) -> str:
        raise SystemExit("no words")


@pytest.mark.parametrize(
    ("told", "words"),
    [
        (describe_error(ValueError("no such table")), "ValueError: no such table"),
        (describe_error(KeyboardInterrupt()), "KeyboardInterrupt: "),
        (describe_error(Untold()), "Untold, whose message raises SystemExit"),
        (describe_exit(0), "it ended its process with status 0"),
        (describe_exit(3), "it ended its process with status 3"),
        (describe_exit(-9), "it ended its process by SIGKILL"),
        (describe_exit(-50), "it ended its process by signal 50"),
    ],
)
def test_an_exception_and_an_end_are_told(told: str, words: str) -> None:
    assert told == words
