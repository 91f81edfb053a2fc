"""How a check says what it found."""

from __future__ import annotations


class ConformanceFailure(AssertionError):
    """A plugin breaks the contract: what was being checked, on what, what came and what should have come."""

    def __init__(self, where: str, got: object, expected: str) -> None:
        super().__init__(f"{where}: got {got}; expected {expected}")
        self.where = where
        self.got = got
        self.expected = expected


class NotClaimed(Exception):
    """The check is about something that the codec, or this setting of it, does not claim; the text says what."""
