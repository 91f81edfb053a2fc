"""Folders of the cache, and which files in them may be run as code.

Trusted are files of this user and of root that nobody else may write.
"""

from __future__ import annotations

import functools
import importlib.util
import logging
import os
import pwd
import stat
from pathlib import Path

import platformdirs

log = logging.getLogger("codecbench.kernels")

FOLDER_MODE = 0o755
FILE_MODE = 0o644
"""Readable by all, so that kernels that root compiled into a container image serve its users."""

_WRITABLE_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH
_reported: set[str] = set()
"""Paths whose refusal this process has logged."""


def cache_folder() -> Path:
    """Return the folder for what can be made or fetched again: `$CODECBENCH_CACHE`, else the platform's cache."""
    variable = os.environ.get("CODECBENCH_CACHE")
    return Path(variable).expanduser() if variable else Path(platformdirs.user_cache_dir("codecbench"))


def kernel_folder() -> Path | None:
    """Return the folder of compiled kernels: in the cache folder, else in the user's own cache; None if none serves.

    A folder that others own or may write is refused, with a line in the log.
    """
    user_cache = Path(platformdirs.user_cache_dir("codecbench"))
    folders = (cache_folder() / "kernels", user_cache / "kernels")
    return next((folder for folder in folders if _is_trusted(folder, may_be_missing=True)), None)


def precompiled_folders() -> list[Path]:
    """Return the folders of kernels compiled elsewhere: that in CODECBENCH_KERNELS, then `codecbench_kernels`.

    That package is all that the distribution `codecbench-kernels` contains. Nothing is written into these folders, and
    one that others own or may write is refused, with a line in the log.
    """
    variable = os.environ.get("CODECBENCH_KERNELS")
    folders = [Path(variable).expanduser()] if variable else []
    return [folder for folder in (*folders, *_installed_folders()) if _is_trusted(folder)]


@functools.cache
def _installed_folders() -> tuple[Path, ...]:
    spec = importlib.util.find_spec("codecbench_kernels")
    return tuple(map(Path, (spec and spec.submodule_search_locations) or ()))


def _is_trusted(folder: Path, *, may_be_missing: bool = False) -> bool:
    try:
        reason = objection(folder.stat())
    except OSError as error:
        if may_be_missing and isinstance(error, FileNotFoundError):
            return True
        reason = f"it cannot be inspected ({error.strerror})"
    if reason is not None:
        refuse(folder, reason)
    return reason is None


def read_trusted(file: Path) -> bytes | None:
    """Return the content of a file; None if it cannot be read, or is refused with a line in the log."""
    try:
        with open(file, "rb") as stream:
            reason = objection(os.fstat(stream.fileno()))
            if reason is None:
                return stream.read()
    except OSError:
        return None
    refuse(file, reason)
    return None


def objection(facts: os.stat_result) -> str | None:
    """Return why a file or folder is not trusted, from its owner and mode; None if it is trusted."""
    if facts.st_uid not in (0, current_user()):
        return f"it belongs to {_name(facts.st_uid)}"
    if facts.st_mode & _WRITABLE_BY_OTHERS:
        return f"users other than its owner may write to it ({stat.filemode(facts.st_mode)})"
    return None


def refuse(path: Path, reason: str) -> None:
    """Log once in a process what is refused, why, what is allowed and what to do."""
    if str(path) in _reported:
        return
    _reported.add(str(path))
    log.warning(
        "%s: compiled kernels are not loaded from here: %s; only you or root may own and write them, because they are "
        "run as code. They are stored elsewhere or compiled in memory; to use this place: chown it, `chmod -R go-w` "
        "it, or set CODECBENCH_CACHE to a folder of your own",
        path,
        reason,
    )


def current_user() -> int:
    """Return the effective user id; tests replace it."""
    return os.geteuid()


def _name(user: int) -> str:
    try:
        return f"user {pwd.getpwuid(user).pw_name}"
    except KeyError:
        return f"user {user}"
