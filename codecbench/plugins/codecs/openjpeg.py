"""Find OpenJPEG for glymur, which does not bundle it.

Order: what glymur finds itself (its configuration file, then the system's library), then the copy inside Pillow's
wheel, so that JPEG 2000 works after a bare `pip install`. Users may name a library in
glymur's `glymurrc`, in the working or the user's configuration folder; glymur reads it once, at its first import.

Pillow's own JPEG 2000 plugin is not used. With the same OpenJPEG it writes the same bytes and reads the same
pixels (567 codings of 27 pictures; a test repeats some), encodes color in 4 % less time and decodes gray in 8 to
18 % less, but decodes color in 8 to 24 % more. It always uses its own OpenJPEG; through glymur we measure the system's
library, which other programs use too.
"""

from __future__ import annotations

import ctypes
import importlib
import importlib.metadata
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from codecbench.core.contracts.errors import Unsupported

_OLDEST_VERSION = (2, 4)  # what glymur writes with
_LOAD_LOCK = threading.Lock()


def load_glymur() -> ModuleType:
    """Import glymur with a working OpenJPEG and one thread per image.

    Raises Unsupported, with the package to install, if there is no OpenJPEG of 2.4 or later.
    """
    with _LOAD_LOCK:
        return _load_glymur()


@cache
def _load_glymur() -> ModuleType:
    import glymur  # its import searches for OpenJPEG

    if not _is_usable(glymur):
        for path in _bundled_libraries():
            _attach(glymur, path)
            if _is_usable(glymur):
                break
        else:
            raise Unsupported(
                "jpeg2000: no OpenJPEG of version 2.4 or later: neither the system nor Pillow's wheel has one; "
                "install it with `apt install libopenjp2-7` or `pip install --force-reinstall pillow`"
            )
    glymur.set_option("lib.num_threads", 1)
    return glymur  # type: ignore[no-any-return]


@contextmanager
def lenient_decoding(glymur: ModuleType) -> Iterator[None]:
    """Have OpenJPEG decode truncated files as far as they go instead of refusing them.

    glymur has no option for that, so its setup step is replaced meanwhile, for the whole process. Raises Unsupported if
    OpenJPEG is older than 2.5.
    """
    binding = glymur.lib.openjp2
    if not hasattr(binding.OPENJP2, "opj_decoder_set_strict_mode"):
        raise Unsupported(f"jpeg2000: OpenJPEG {binding.version()} cannot decode a part of a file; 2.5 and later can")
    set_strict_mode = binding.OPENJP2.opj_decoder_set_strict_mode
    set_strict_mode.argtypes, set_strict_mode.restype = [binding.CODEC_TYPE, ctypes.c_int], ctypes.c_int
    prepare = binding.setup_decoder

    def prepare_leniently(codec: Any, parameters: Any) -> None:
        prepare(codec, parameters)
        set_strict_mode(codec, 0)

    binding.setup_decoder = prepare_leniently
    try:
        yield
    finally:
        binding.setup_decoder = prepare


def _is_usable(glymur: ModuleType) -> bool:
    library = glymur.lib.openjp2
    return library.OPENJP2 is not None and tuple(map(int, library.version().split(".")[:2])) >= _OLDEST_VERSION


def _bundled_libraries() -> list[Path]:
    """Paths of libopenjp2 among the files that Pillow's distribution installed."""
    try:
        files = importlib.metadata.files("pillow") or []
    except importlib.metadata.PackageNotFoundError:
        return []
    paths = [Path(str(file.locate())) for file in files if "openjp2" in file.name]
    return sorted(path for path in paths if path.is_file())


def _attach(glymur: ModuleType, path: Path) -> None:
    """Make glymur use the library at `path`.

    Its binding reads the library's version at import, to lay out structures. So it is reloaded while its search for a
    library is replaced by ours.
    """
    config = glymur.config
    search = config.glymur_config
    config.glymur_config = lambda _: _load_library(path)
    try:
        importlib.reload(glymur.lib.openjp2)
    finally:
        config.glymur_config = search
    glymur.version.openjpeg_version = glymur.lib.openjp2.version()


def _load_library(path: Path) -> ctypes.CDLL | None:
    try:
        return ctypes.CDLL(str(path))
    except OSError:
        return None
