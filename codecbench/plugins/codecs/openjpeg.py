"""Finding OpenJPEG for glymur, which brings none of its own.

Order: what glymur finds itself (its configuration file, then the system's library), then the copy inside Pillow's
wheel, so that JPEG 2000 works after a bare `pip install`. glymur's own way to name a library, a `glymurrc` in the
working or the user's configuration folder, is read once, at the first import, and is the user's to write.

Pillow's own JPEG 2000 plugin needs none of this. With the same OpenJPEG it writes the same bytes and reads the same
pixels (567 codings of 27 pictures; a test repeats some), encodes colour in 4 % less time and decodes gray in 8 to
18 % less, but decodes colour in 8 to 24 % more, and it always uses its own OpenJPEG: going through glymur, a codec
that is measured is that of the system, as other programs use it.
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

_OLDEST = (2, 4)  # what glymur writes with
_LOADING = threading.Lock()


def load_glymur() -> ModuleType:
    """glymur with a working OpenJPEG, one thread a picture.

    Raises Unsupported, naming the package to install, where no OpenJPEG of 2.4 or later is found.
    """
    with _LOADING:
        return _load_glymur()


@cache
def _load_glymur() -> ModuleType:
    import glymur

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
def tolerant(glymur: ModuleType) -> Iterator[None]:
    """Have OpenJPEG decode as far as a file goes, where it otherwise refuses one that ends early.

    glymur has no way to ask for that, so its step before decoding does it meanwhile, for whoever decodes in this
    process. Raises Unsupported where OpenJPEG is older than 2.5.
    """
    binding = glymur.lib.openjp2
    if not hasattr(binding.OPENJP2, "opj_decoder_set_strict_mode"):
        raise Unsupported(f"jpeg2000: OpenJPEG {binding.version()} decodes no part of a file; 2.5 and later do")
    lenient = binding.OPENJP2.opj_decoder_set_strict_mode
    lenient.argtypes, lenient.restype = [binding.CODEC_TYPE, ctypes.c_int], ctypes.c_int
    prepare = binding.setup_decoder

    def prepare_leniently(codec: Any, parameters: Any) -> None:
        prepare(codec, parameters)
        lenient(codec, 0)

    binding.setup_decoder = prepare_leniently
    try:
        yield
    finally:
        binding.setup_decoder = prepare


def _is_usable(glymur: ModuleType) -> bool:
    library = glymur.lib.openjp2
    return library.OPENJP2 is not None and tuple(map(int, library.version().split(".")[:2])) >= _OLDEST


def _bundled_libraries() -> list[Path]:
    """Copies of libopenjp2 among the files that Pillow's distribution installed."""
    try:
        files = importlib.metadata.files("pillow") or []
    except importlib.metadata.PackageNotFoundError:
        return []
    paths = [Path(str(file.locate())) for file in files if "openjp2" in file.name]
    return sorted(path for path in paths if path.is_file())


def _attach(glymur: ModuleType, path: Path) -> None:
    """Make glymur use the library at `path`.

    Its binding reads the library's version while it is imported, to lay out structures, so it is imported
    anew with the search for a library answered by us.
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
