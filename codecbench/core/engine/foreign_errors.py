"""What becomes of other people's code, in words: its exceptions and the ends of its processes."""

from __future__ import annotations

import signal


def describe_error(error: BaseException) -> str:
    """The kind and the message of an exception, also of one that cannot say it: `ValueError: no such table`."""
    kind = type(error).__name__
    try:
        return f"{kind}: {error}"
    except BaseException as second:  # noqa: BLE001 - a message that cannot be made is no reason to fail here
        return f"{kind}, whose message raises {type(second).__name__}"


def ended(status: int) -> str:
    """How a process ended by its status, which is negative where a signal ended it."""
    if status >= 0:
        return f"it ended its process with status {status}"
    try:
        return f"it ended its process by {signal.Signals(-status).name}"
    except ValueError:  # signals without a name
        return f"it ended its process by signal {-status}"
