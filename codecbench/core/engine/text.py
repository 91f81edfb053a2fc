"""Make texts of plugins, records and plans safe to show: no control characters, limited length.

Texts are cleaned once, at their source: when something fails in a worker, and when a run folder is read. Output code
then only escapes what its format would take for markup.
"""

from __future__ import annotations

import re
import signal
from typing import Any, Final

from codecbench.core.engine.identity import content_digest

LINE_LIMIT: Final = 1_000
"""Maximum characters of a name, a label or a reason."""

TEXT_LIMIT: Final = 100_000
"""Maximum characters of a multi-line text: a traceback, a matrix."""

_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u200b-\u200f\u2028-\u202e\u2060-\u2069\ufeff\ud800-\udfff]")
"""Control characters except tab and line feed, bidirectional and zero-width marks, and lone surrogates."""


def clean_line(text: str) -> str:
    r"""Return one line of at most about `LINE_LIMIT` characters, with unprintable characters escaped (`\\x1b`)."""
    return _cut(_escape(" ".join(text.split()) if "\n" in text or "\t" in text or "\r" in text else text), LINE_LIMIT)


def clean_text(text: str) -> str:
    """Return lines of at most about `TEXT_LIMIT` characters in total."""
    return _cut(_escape(text), TEXT_LIMIT)


def clean_value(value: Any) -> Any:
    """Clean every text in a JSON value, including keys, with `clean_line`."""
    if isinstance(value, str):
        return clean_line(value)
    if isinstance(value, dict):
        return {clean_line(name): clean_value(part) for name, part in value.items()}
    if isinstance(value, list):
        return [clean_value(part) for part in value]
    return value


def _escape(text: str) -> str:
    return _CONTROL.sub(lambda match: match.group().encode("unicode_escape").decode(), text)


def _cut(text: str, limit: int) -> str:
    """Truncate a text and append a digest of the whole, so that different texts stay different."""
    if len(text) <= limit:
        return text
    digest = content_digest(text.encode("utf-8", "backslashreplace"))[:8]
    return f"{text[:limit]}... ({len(text):,} characters, digest {digest})"


def describe_error(error: BaseException) -> str:
    """Return type and message of an exception, even if its message cannot be made: `ValueError: no such table`."""
    kind = type(error).__name__
    try:
        return f"{kind}: {error}"
    except BaseException as secondary:  # noqa: BLE001 - a broken message must not fail here
        return f"{kind} (its message raises {type(secondary).__name__})"


def describe_exit(status: int) -> str:
    """Describe how a process ended, from its status, which is negative if a signal ended it."""
    if status >= 0:
        return f"its process exited with status {status}"
    try:
        return f"its process was killed by {signal.Signals(-status).name}"
    except ValueError:  # the signal has no name
        return f"its process was killed by signal {-status}"


def counted(count: int, noun: str) -> str:
    """Format a count: `1 frame`, `1,204 frames`."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"
