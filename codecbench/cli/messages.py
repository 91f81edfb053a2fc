"""Messages and exit statuses of commands. This module imports little and in particular not rich."""

from __future__ import annotations

import errno
import os
import shutil
import sys
import textwrap
import traceback
from contextlib import suppress
from enum import IntEnum
from typing import Final

import click

from codecbench.core.contracts.errors import CodecbenchError, StoreError
from codecbench.core.engine import text as terminal_text


class ExitStatus(IntEnum):
    """Exit statuses of commands; docs/commands.md lists them command by command."""

    SUCCESS = 0
    FOUND = 1
    """The command did its work and found something wrong: failed cells or checks, a run that became worse."""
    WRONG_USE = 2
    """The request is wrong: options, a matrix, a name, a folder that is not a run."""
    NOT_POSSIBLE = 3
    """The machine or a file prevents it: disk full, no permission, damaged, no connection."""
    FAULT = 70
    """An error in codecbench itself."""
    INTERRUPTED = 130
    BROKEN_PIPE = 141
    """The program that read the output ended."""


DEBUG: Final = "CODECBENCH_DEBUG"
"""The environment variable that shows tracebacks on the screen."""

_HINTS: Final = {
    errno.ENOSPC: "make room on that disk, or choose a place on another",
    errno.EDQUOT: "your quota is used up: make room, or choose a place elsewhere",
    errno.EFBIG: "files may not become that large here; see `ulimit -f`",
    errno.EROFS: "choose a place that can be written",
    errno.EACCES: "choose another place, or ask its owner for the permission",
    errno.EPERM: "choose another place, or ask its owner for the permission",
    errno.EEXIST: "a file is where a folder is expected: move it, or choose another place",
    errno.ENOTDIR: "a file is where a folder is expected: move it, or choose another place",
    errno.EISDIR: "a folder is where a file is expected: choose another place",
    errno.EMFILE: "too many files are open; see `ulimit -n`",
}

_NO_TEMPORARY_DIRECTORY: Final = "No usable temporary directory found"
"""The beginning of the message of `tempfile` if it can write to no folder; a list of folders follows."""


def report_error(error: BaseException) -> ExitStatus:
    """Print what ended a command on standard error and return the exit status."""
    if isinstance(error, BrokenPipeError):
        return ExitStatus.BROKEN_PIPE
    if isinstance(error, click.exceptions.Abort | KeyboardInterrupt):
        click.echo("stopped", err=True)
        return ExitStatus.INTERRUPTED
    if os.environ.get(DEBUG):
        traceback.print_exception(error)
    if isinstance(error, click.ClickException):
        error.show()
        return ExitStatus(error.exit_code)
    if isinstance(error, OSError):
        click.echo(f"Error: {_describe(error)}", err=True)
        return ExitStatus.NOT_POSSIBLE
    if isinstance(error, CodecbenchError):
        hint = _HINTS.get(error.__cause__.errno or 0) if isinstance(error.__cause__, OSError) else None
        click.echo(f"Error: {error}" + (f"; {hint}" if hint else ""), err=True)
        return ExitStatus.NOT_POSSIBLE if _is_system_error(error) else ExitStatus.WRONG_USE
    click.echo(f"Error in codecbench: {type(error).__name__}: {error}{_save_traceback(error)}", err=True)
    return ExitStatus.FAULT


def close_output() -> None:
    """Flush standard output and error.

    Output that cannot be written is dropped, so that Python prints no error when it exits. Raises OSError then.
    """
    failure: OSError | None = None
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError as error:
            failure = failure or error
            with suppress(OSError, ValueError):
                nowhere = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nowhere, stream.fileno())
                os.close(nowhere)
    if failure is not None:
        raise failure


def _is_system_error(error: CodecbenchError) -> bool:
    """Return whether the system or a damaged file caused an error, and not the request of the user."""
    cause = error.__cause__
    return isinstance(cause, OSError) or (isinstance(error, StoreError) and cause is not None)


def _describe(error: OSError) -> str:
    """Describe what failed, where, and what to do next."""
    if error.errno is None:
        return str(error) or type(error).__name__
    what = error.strerror or errno.errorcode.get(error.errno, f"error {error.errno}")
    where = f"{os.fsdecode(error.filename)}: " if isinstance(error.filename, str | bytes) else ""
    hint = _HINTS.get(error.errno)
    if what.startswith(_NO_TEMPORARY_DIRECTORY):
        hint = "make room in one of them, or set TMPDIR to a folder that can be written"
    return f"{where}{what}" + (f"; {hint}" if hint else "")


def _save_traceback(error: BaseException) -> str:
    """Write the traceback to a file; return a line that names the file or says how to see the traceback."""
    if os.environ.get(DEBUG):
        return ""
    import tempfile  # only such an error needs it, and help is to be quick

    try:
        handle, name = tempfile.mkstemp(prefix="codecbench-fault-", suffix=".txt")
        with os.fdopen(handle, "w", encoding="utf-8") as stream:
            stream.write("".join(traceback.format_exception(error)))
    except OSError:
        return f"\n{DEBUG}=1 shows the traceback"
    return f"\nthe traceback is in {name}; please report the error with that file"


def say(text: str, *, indent: int = 0, err: bool = False, fg: str | None = None, bold: bool | None = None) -> None:
    """Print a line, cleaned of control characters. indent: spaces before all but its first row if it is wrapped.

    On a terminal, or if COLUMNS is set, the line is wrapped between words; paths and addresses stay whole. Else it is
    one row, so that `tail -n 1` shows all of the last message.
    """
    text = terminal_text.clean_text(text.replace("\n", " "))
    if (sys.stderr if err else sys.stdout).isatty() or "COLUMNS" in os.environ:
        width = shutil.get_terminal_size().columns
        text = textwrap.fill(
            text, width, subsequent_indent=" " * indent, break_long_words=False, break_on_hyphens=False
        )
    click.secho(text, err=err, fg=fg, bold=bold)
