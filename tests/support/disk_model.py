"""What a disk holds of a folder when the power is cut: what was waited for, and of the rest as little as it may."""

from __future__ import annotations

import os
import stat
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

State = dict[str, bytes | None]
"""The content of every file below a folder by its path; None for a folder."""

CHANGING = ("os.rename", "os.mkdir", "os.remove", "os.rmdir")
"""Events of `sys.addaudithook`, which come before what they announce."""

RESTS: dict[str, Callable[[bytes], bytes]] = {
    "kept": lambda rest: rest,
    "nothing": lambda rest: b"",
    "half": lambda rest: rest[: len(rest) // 2],
    "zeros": lambda rest: bytes(len(rest)),
}
"""What may be on the disk of bytes that nobody waited for."""


@dataclass
class Disk:
    """Follows a folder whose present content the disk has, operation by operation.

    moments: before each operation, and at the end, what is to come and every state that the disk may then be in, by
    what became of bytes and names that were not waited for.
    """

    root: Path
    moments: list[tuple[str, dict[str, State]]] = field(default_factory=list)
    _open: dict[int, int] = field(default_factory=dict)
    _bytes: dict[int, bytes] = field(default_factory=dict)
    _names: dict[int, dict[str, int]] = field(default_factory=dict)

    @contextmanager
    def following(self, writer: Any) -> Iterator[None]:
        """Meanwhile each operation is followed; `writer` is the module that has things waited for."""
        self.sync_everything()
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(writer, "os", self)
            patch.setattr(writer, "_libc", self)
            _followed.append(self)
            try:
                yield
                self.moment("the end")
            finally:
                _followed.remove(self)
                for handle in self._open.values():
                    os.close(handle)

    def __getattr__(self, name: str) -> Any:
        return getattr(os, name)

    def fsync(self, handle: int) -> None:
        self.moment("fsync")
        os.fsync(handle)
        if (inode := os.fstat(handle).st_ino) in self._look():
            self._sync(inode)

    def syncfs(self, _: int) -> int:
        self.moment("syncfs")
        self.sync_everything()
        return 0

    def sync_everything(self) -> None:
        for inode in self._look():
            self._sync(inode)

    def moment(self, what: str) -> None:
        self._look()
        root = os.stat(self.root).st_ino
        states = {
            f"{names} names, {rest}": dict(self._below(root, "", names == "new", RESTS[rest]))
            for names, rest in [("new", rest) for rest in RESTS] + [("old", "kept"), ("old", "zeros")]
        }
        self.moments.append((what, states))

    def _look(self) -> set[int]:
        """The inodes that are below the folder now. Each is held open, so that its number stays its own."""
        found = {self._hold(self.root)}
        for parent, folders, files in os.walk(self.root):
            found |= {self._hold(Path(parent, name)) for name in (*folders, *files)}
        return found

    def _hold(self, path: Path) -> int:
        inode = os.stat(path).st_ino
        if inode not in self._open:
            self._open[inode] = os.open(path, os.O_RDONLY)
        return inode

    def _sync(self, inode: int) -> None:
        if self._is_folder(inode):
            self._names[inode] = self._names_now(inode)
        else:
            self._bytes[inode] = self._bytes_now(inode)

    def _is_folder(self, inode: int) -> bool:
        return stat.S_ISDIR(os.fstat(self._open[inode]).st_mode)

    def _names_now(self, inode: int) -> dict[str, int]:
        return {entry.name: entry.inode() for entry in os.scandir(self._open[inode])}

    def _bytes_now(self, inode: int) -> bytes:
        return os.pread(self._open[inode], os.fstat(self._open[inode]).st_size, 0)

    def _below(
        self, folder: int, path: str, new_names: bool, rest: Callable[[bytes], bytes]
    ) -> Iterator[tuple[str, bytes | None]]:
        names = self._names_now(folder) if new_names else self._names.get(folder, {})
        for name, inode in names.items():
            if self._is_folder(inode):
                yield f"{path}{name}", None
                yield from self._below(inode, f"{path}{name}/", new_names, rest)
                continue
            now, then = self._bytes_now(inode), self._bytes.get(inode, b"")
            waited = then if now.startswith(then) else b""
            yield f"{path}{name}", waited + rest(now[len(waited) :])


_followed: list[Disk] = []


def _announced(event: str, words: tuple[Any, ...]) -> None:
    """The hook: `os` itself is left as it is, for codecbench looks whether a plugin changed it."""
    if event in CHANGING:
        for disk in _followed:
            if os.path.isabs(words[0]) and not Path(words[0]).is_relative_to(disk.root):
                continue
            disk.moment(f"{event} {' '.join(map(str, words))}")


sys.addaudithook(_announced)


def put(state: State, folder: Path) -> None:
    """Make `folder` what a state says."""
    folder.mkdir()
    for path, content in state.items():
        if content is None:
            (folder / path).mkdir()
        else:
            (folder / path).write_bytes(content)
