"""Text made fit to be shown: of plugins, records and plans without control characters and never endless; and counts.

It passes here once, where it comes in: when something fails in a worker, and when a run folder is read. What shows it
then only escapes what its format would take for markup.
"""

from __future__ import annotations

import re
import signal
from typing import Any, Final

from codecbench.core.engine.identity import content_digest

LINE_LIMIT: Final = 1_000
"""Characters of a name, a label or a reason."""

TEXT_LIMIT: Final = 100_000
"""Characters of a text of many lines: a traceback, a matrix."""

_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u200b-\u200f\u2028-\u202e\u2060-\u2069\ufeff\ud800-\udfff]")
"""Control characters but tab and line feed, those that turn the direction of writing, and halves of surrogates."""


def clean_line(text: str) -> str:
    """One line of at most about `LINE_LIMIT` characters; whatever else is no plain text is spelt out (`\\x1b`)."""
    return _cut(_escape(" ".join(text.split()) if "\n" in text or "\t" in text or "\r" in text else text), LINE_LIMIT)


def clean_text(text: str) -> str:
    """Lines of at most about `TEXT_LIMIT` characters together."""
    return _cut(_escape(text), TEXT_LIMIT)


def clean_value(value: Any) -> Any:
    """A JSON value with every text in it, names of entries too, as `clean_line` gives it."""
    if isinstance(value, str):
        return clean_line(value)
    if isinstance(value, dict):
        return {clean_line(name): clean_value(part) for name, part in value.items()}
    if isinstance(value, list):
        return [clean_value(part) for part in value]
    return value


def _escape(text: str) -> str:
    return _CONTROL.sub(lambda found: found.group().encode("unicode_escape").decode(), text)


def _cut(text: str, limit: int) -> str:
    """The text, or its beginning with a digest of the whole, so that different texts stay different."""
    if len(text) <= limit:
        return text
    mark = content_digest(text.encode("utf-8", "backslashreplace"))[:8]
    return f"{text[:limit]}... ({len(text):,} characters, digest {mark})"


def describe_error(error: BaseException) -> str:
    """The kind and the message of an exception, also of one that cannot say it: `ValueError: no such table`."""
    kind = type(error).__name__
    try:
        return f"{kind}: {error}"
    except BaseException as second:  # noqa: BLE001 - a message that cannot be made is no reason to fail here
        return f"{kind}, whose message raises {type(second).__name__}"


def describe_exit(status: int) -> str:
    """How a process ended by its status, which is negative where a signal ended it."""
    if status >= 0:
        return f"it ended its process with status {status}"
    try:
        return f"it ended its process by {signal.Signals(-status).name}"
    except ValueError:  # signals without a name
        return f"it ended its process by signal {-status}"


def counted(count: int, noun: str) -> str:
    """`1 frame`, `1,204 frames`."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"
