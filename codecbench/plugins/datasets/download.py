"""Resumable downloads over HTTP, and safe unpacking of archives."""

from __future__ import annotations

import fcntl
import http.client
import shutil
import tarfile
import tempfile
import time
import urllib.error
import urllib.request
import zipfile
from collections.abc import Callable, Iterator
from fnmatch import fnmatch
from pathlib import Path, PurePosixPath
from typing import IO, Any

from codecbench.core.contracts.errors import DatasetError

Progress = Callable[[int, int | None], None]
"""Called with the bytes of a file received so far, and the total if the server gives it."""

_CHUNK_BYTES = 1 << 18
_TIMEOUT_S = 60.0


class ResumingDownloader:
    """A downloader for pooch that resumes: each try requests only the bytes that are still missing.

    partial: file that holds the bytes received, between tries and calls. After `tries` connections without new bytes
    the download fails with DatasetError, and the partial file stays for the next call.
    """

    def __init__(self, partial: Path, progress: Progress | None = None, tries: int = 4, pause_s: float = 2.0) -> None:
        self._partial = partial
        self._version = partial.with_name(partial.name + ".version")
        self._progress = progress or (lambda done, total: None)
        self._tries = tries
        self._pause_s = pause_s

    def __call__(self, url: str, output_file: str | Path, pooch: Any = None) -> None:
        try:
            self._partial.parent.mkdir(parents=True, exist_ok=True)
            with open(self._partial, "ab") as stream:
                self._lock(stream)
                self._fill(url, stream)
            self._partial.replace(output_file)
            self._version.unlink(missing_ok=True)
        except OSError as error:
            raise DatasetError(f"{self._partial}: cannot be written: {error.strerror or error}") from error

    def _lock(self, stream: IO[bytes]) -> None:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise DatasetError(f"{self._partial}: another process is fetching this file; wait for it") from error

    def _fill(self, url: str, stream: IO[bytes]) -> None:
        failures = 0
        while True:
            before = stream.tell()
            try:
                if self._receive(url, stream):
                    return
                reason = "the connection was cut"
            except urllib.error.HTTPError as error:
                if error.code < 500:
                    raise DatasetError(f"{url}: the server returned {error.code} {error.reason}") from error
                reason = f"the server returned {error.code} {error.reason}"
            except (urllib.error.URLError, http.client.HTTPException, TimeoutError, ConnectionError) as error:
                reason = str(getattr(error, "reason", error)) or type(error).__name__
            failures = failures + 1 if stream.tell() <= before else 0
            if failures >= self._tries:
                raise DatasetError(f"{url}: {reason} after {stream.tell()} bytes; fetch again to resume")
            time.sleep(self._pause_s)

    def _receive(self, url: str, stream: IO[bytes]) -> bool:
        """Receive over one connection; return whether the file is complete."""
        with self._request(url, stream) as response:
            if response.status != 206:
                stream.seek(0)
                stream.truncate()
            start = stream.tell()
            length = response.headers.get("Content-Length")
            total = None if length is None else start + int(length)
            self._version.write_text(response.headers.get("ETag") or response.headers.get("Last-Modified") or "")
            while chunk := response.read(_CHUNK_BYTES):
                stream.write(chunk)
                self._progress(stream.tell(), total)
            stream.flush()
        return total is None or stream.tell() >= total

    def _request(self, url: str, stream: IO[bytes]) -> Any:
        """Open the response: the rest of the same version of the file, or else the whole file."""
        request = urllib.request.Request(url, headers={"User-Agent": "codecbench"})
        version = self._version.read_text() if self._version.is_file() else ""
        if stream.tell() and version:
            request.add_header("Range", f"bytes={stream.tell()}-")
            request.add_header("If-Range", version)
        try:
            return urllib.request.urlopen(request, timeout=_TIMEOUT_S)
        except urllib.error.HTTPError as error:
            if error.code != 416:
                raise
            stream.seek(0)
            stream.truncate()
            return urllib.request.urlopen(url, timeout=_TIMEOUT_S)


def unpack(archive: Path, folder: Path, inside: str = "", leave_out: tuple[str, ...] = ()) -> None:
    """Unpack the files of a .zip or tar archive into `folder`, which appears complete or not at all.

    inside: only this folder of the archive is unpacked. leave_out: patterns of names to skip. Raises DatasetError
    if the archive is damaged, or if a member is a link, a device or outside the folder.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    new = Path(tempfile.mkdtemp(prefix=".new-", dir=folder.parent))
    try:
        count = 0
        for name, stream in _members(archive):
            path = _safe_path(name, archive)
            if inside and path.parts[: len(PurePosixPath(inside).parts)] != PurePosixPath(inside).parts:
                continue
            if any(fnmatch(name, pattern) for pattern in leave_out):
                continue
            target = new / path.relative_to(inside)
            target.parent.mkdir(parents=True, exist_ok=True)
            with open(target, "wb") as output:
                shutil.copyfileobj(stream, output, 1 << 20)
            count += 1
        if not count:
            raise DatasetError(f"{archive}: contains no files" + (f" in {inside}/" if inside else ""))
        new.chmod(0o755)
        new.rename(folder)
    except (tarfile.TarError, zipfile.BadZipFile, EOFError, ValueError, NotImplementedError) as error:
        # zipfile raises NotImplementedError for an unknown compression method
        raise DatasetError(f"{archive}: is damaged or not an archive: {error}; fetch it again") from error
    except OSError as error:
        raise DatasetError(f"{archive}: cannot be unpacked into {folder}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(new, ignore_errors=True)


def _members(archive: Path) -> Iterator[tuple[str, IO[bytes]]]:
    """Yield name and content of every file in the archive."""
    if archive.suffix == ".zip":
        with zipfile.ZipFile(archive) as packed:
            for info in packed.infolist():
                if not info.is_dir():
                    if (info.external_attr >> 28) == 0o12:
                        raise DatasetError(f"{archive}: {info.filename!r} is a link; nothing was unpacked")
                    with packed.open(info) as stream:
                        yield info.filename, stream
        return
    with tarfile.open(archive, "r:*") as packed_tar:
        for member in packed_tar:
            if member.isdir():
                continue
            if not member.isreg():
                raise DatasetError(f"{archive}: {member.name!r} is a link or a device; nothing was unpacked")
            content = packed_tar.extractfile(member)
            if content is not None:
                yield member.name, content


def _safe_path(name: str, archive: Path) -> PurePosixPath:
    """The path of a member. Raises DatasetError if it is empty or would lie outside the folder."""
    path = PurePosixPath(name)
    if not path.parts:
        raise DatasetError(f"{archive}: {name!r} is not a file name; nothing was unpacked")
    if path.is_absolute() or ".." in path.parts or "\\" in name or ":" in path.parts[0]:
        raise DatasetError(f"{archive}: {name!r} would lie outside its folder; nothing was unpacked")
    return path
