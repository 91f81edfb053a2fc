"""Whatever an exception or an exit status is, there are words for it."""

from __future__ import annotations

import pytest

from codecbench.core.engine.text import describe_error, describe_exit


class Broken(Exception):
    def __str__(self) -> str:
        raise SystemExit("no words")


@pytest.mark.parametrize(
    ("text", "ending"),
    [
        (describe_error(ValueError("no table")), "ValueError: no table"),
        (describe_error(KeyboardInterrupt()), "KeyboardInterrupt: "),
        (describe_error(Broken()), "raises SystemExit)"),
        (describe_exit(0), "exited with status 0"),
        (describe_exit(3), "exited with status 3"),
        (describe_exit(-9), "killed by SIGKILL"),
        (describe_exit(-50), "killed by signal 50"),
    ],
)
def test_every_exception_and_exit_status_has_a_description(text: str, ending: str) -> None:
    assert text.endswith(ending)
