"""A corpus of bitstreams with hashes of their decoded pixels, to check other machines and later versions.

    manifest.json          the entries, and what wrote them
    <codec>/<number>.bin   bitstreams

A bitstream must decode to the same pixels everywhere and forever. A later version of the codec may write other bytes.
If an encoder writes other bytes with unchanged versions of itself and its libraries, its version was not raised, or it
depends on the machine.
"""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import ValidationError

from codecbench.core.conformance.material import GENERATOR, integer_image
from codecbench.core.conformance.sandbox import Reply, Verb, sandbox
from codecbench.core.contracts.codec import Codec
from codecbench.core.contracts.errors import PluginError, StoreError, Unsupported
from codecbench.core.contracts.image import Image, Layout
from codecbench.core.contracts.params import Params
from codecbench.core.engine.identity import json_from_bytes
from codecbench.core.engine.storage.atomic import write_file

CodecClass = type[Codec[Any]]
_FORMAT = 1
_MANIFEST = "manifest.json"
_SIZES = ((1, 1), (17, 31), (88, 120))
_TIMEOUT_S = 60.0
_MEMORY_MB = 1024


@dataclass(frozen=True)
class Entry:
    """A bitstream of the corpus: what wrote it, for which image, and what it decoded to."""

    file: str
    """Path in the corpus."""
    codec: str
    version: str
    """Version of the codec."""
    libraries: dict[str, str]
    """Versions of its libraries, by name."""
    params: dict[str, Any]
    generator: str
    """Name and version of the image generator."""
    seed: int
    shape: tuple[int, int, int]
    """Height, width and channels of the image."""
    bitstream_sha256: str
    pixels_sha256: str
    """Hash of the decoded image, as `pixels_sha256` computes it."""
    bits: int = 8
    """Bits of the image's samples."""


@dataclass(frozen=True)
class EntryResult:
    """Result of checking an entry."""

    entry: Entry
    status: Literal["passed", "failed", "skipped"]
    """`skipped` if its codec is not available."""
    reason: str = ""
    """Why it failed or was skipped."""
    note: str = ""
    """A remark on an entry that passed."""


Maker = Callable[[Sequence[Entry]], list[tuple[Entry, bytes]]]
"""Creates bitstreams with their entries, given those that the corpus has already; raises PluginError."""


def pixels_sha256(pixels: Image) -> str:
    """Return the hash of an image's dtype, its shape and its samples, row by row."""
    shape = "x".join(map(str, pixels.shape))
    return hashlib.sha256(f"{pixels.dtype} {shape}\n".encode() + np.ascontiguousarray(pixels).tobytes()).hexdigest()


def write_bitstreams(folder: Path, makers: Sequence[Maker], written_by: str) -> list[Entry]:
    """Write the bitstreams of all makers, one after another, and the manifest into a new or empty folder.

    Raises StoreError if the folder is not empty, and what makers raise; then there is no manifest.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise StoreError(f"{folder} is not empty; choose a new or empty folder for the corpus")
    folder.mkdir(parents=True, exist_ok=True)
    entries: list[Entry] = []
    for make in makers:
        for entry, bitstream in make(entries):
            write_file(folder / entry.file, bitstream)
            entries.append(entry)
    manifest = {
        "format": _FORMAT,
        "written_by": written_by,
        "machine": f"{platform.machine()} {platform.system()}, Python {platform.python_version()}",
        "entries": [asdict(entry) for entry in entries],
    }
    write_file(folder / _MANIFEST, (json.dumps(manifest, indent=1) + "\n").encode())
    return entries


def coded_pictures(codec_class: CodecClass, params: Params, earlier: Sequence[Entry]) -> list[tuple[Entry, bytes]]:
    """Encode the corpus images at a setting, in another process. earlier: entries that the corpus has already.

    An image that the setting does not support is left out. Raises PluginError if the codec fails.
    """
    codec = codec_class(params)
    first = sum(entry.codec == codec.name for entry in earlier)
    bitstreams: list[tuple[Entry, bytes]] = []
    for seed, size in enumerate(_SIZES):
        for layout in codec.capabilities.layouts:
            reply = _ask(codec, "encode", integer_image(seed, *size, *layout))
            if reply.status != "unsupported":
                file = f"{codec.name}/{first + len(bitstreams):03}.bin"
                bitstreams.append(_new_entry(file, codec, seed, size, layout, reply))
    return bitstreams


def _ask(codec: Codec[Any], verb: Verb, argument: Any) -> Reply:
    """Encode or decode at this codec's setting in another process."""
    arguments = type(codec), codec.params, verb, argument
    return sandbox(verb).call(_call_codec, *arguments, timeout_s=_TIMEOUT_S, memory_mb=_MEMORY_MB)


def _call_codec(codec_class: CodecClass, params: Params, verb: Verb, argument: Any) -> Any:
    return getattr(codec_class(params), verb)(argument)


def _new_entry(
    file: str, codec: Codec[Any], seed: int, size: tuple[int, int], layout: Layout, encoded: Reply
) -> tuple[Entry, bytes]:
    decoded = _ask(codec, "decode", encoded.value) if encoded.status == "done" else encoded
    if decoded.status != "done":
        raise PluginError(f"{codec.name}, image {seed} of {size}, {layout}: {decoded.status}: {decoded.reason}")
    bitstream: bytes = encoded.value
    entry = Entry(
        file=file,
        codec=codec.name,
        version=codec.version,
        libraries=codec.libraries(),
        params=codec.params.model_dump(mode="json"),
        generator=GENERATOR,
        seed=seed,
        shape=(*size, layout.channels),
        bits=layout.bits,
        bitstream_sha256=hashlib.sha256(bitstream).hexdigest(),
        pixels_sha256=pixels_sha256(decoded.value),
    )
    return entry, bitstream


def read_manifest(folder: Path) -> list[Entry]:
    """Read the entries of a corpus. Raises StoreError if there is none or it has another format."""
    path = folder / _MANIFEST
    try:
        manifest = json_from_bytes(path.read_bytes())
        if manifest["format"] != _FORMAT:
            raise StoreError(f"{path}: format {manifest['format']}; this version reads {_FORMAT}")
        return [Entry(**{**entry, "shape": tuple(entry["shape"])}) for entry in manifest["entries"]]
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise StoreError(f"{path} is not the manifest of a corpus: {type(error).__name__}: {error}") from error


def check_entry(folder: Path, entry: Entry, load: Callable[[str], CodecClass]) -> EntryResult:
    """Check one entry: decode its bitstream in another process and compare the pixels.

    load: returns the class of a codec by name; raises Unsupported or PluginError if there is none.
    """
    try:
        codec, outdated = _codec_of(entry, load(entry.codec))
    except (Unsupported, PluginError) as error:
        return EntryResult(entry, "skipped", str(error))
    failure = _decoding_failure(folder / entry.file, entry, codec)
    if failure is not None:
        return EntryResult(entry, "failed", failure)
    if outdated:
        return EntryResult(entry, "passed", note="its parameters are not valid any more; only decoded")
    return _reencoding_result(entry, codec)


def _codec_of(entry: Entry, codec_class: CodecClass) -> tuple[Codec[Any], bool]:
    """Return the codec at the entry's setting and False, or, if that is not valid any more, at an example and True."""
    try:
        return codec_class(codec_class.params_type.model_validate(entry.params)), False
    except ValidationError:
        return codec_class.create(**codec_class.examples[0]), True


def _decoding_failure(path: Path, entry: Entry, codec: Codec[Any]) -> str | None:
    try:
        bitstream = path.read_bytes()
    except OSError as error:
        return f"the corpus is damaged: {error}"
    if hashlib.sha256(bitstream).hexdigest() != entry.bitstream_sha256:
        return f"the corpus is damaged: {path} is not what was written"
    reply = _ask(codec, "decode", bitstream)
    if reply.status != "done":
        return f"does not decode: {reply.status}: {reply.reason}{_changes(entry, codec)}"
    if pixels_sha256(reply.value) != entry.pixels_sha256:
        return f"decodes to other pixels, of shape {reply.value.shape}{_changes(entry, codec)}"
    return None


def _reencoding_result(entry: Entry, codec: Codec[Any]) -> EntryResult:
    """Check that the encoder still writes these bytes, as it must unless its version or a library's changed."""
    if entry.generator != GENERATOR:
        return EntryResult(entry, "passed", note=f"only decoded: generator {entry.generator} is not the current one")
    reply = _ask(codec, "encode", integer_image(entry.seed, *entry.shape, entry.bits))
    if reply.status != "done":
        return EntryResult(entry, "failed", f"does not encode its image any more: {reply.status}: {reply.reason}")
    if hashlib.sha256(reply.value).hexdigest() == entry.bitstream_sha256:
        return EntryResult(entry, "passed")
    changes = _changes(entry, codec)
    if changes:
        return EntryResult(entry, "passed", note=f"encodes to other bytes{changes}")
    return EntryResult(
        entry, "failed", "encodes to other bytes, with the same version and libraries: raise `version`, or fix it"
    )


def _changes(entry: Entry, codec: Codec[Any]) -> str:
    """Return a suffix for messages that lists the versions that changed since the entry was written; empty if none."""
    now = {codec.name: codec.version, **codec.libraries()}
    before = {entry.codec: entry.version, **entry.libraries}
    differing = [
        f"{name} {before.get(name, 'absent')} -> {now.get(name, 'absent')}"
        for name in {**before, **now}
        if before.get(name) != now.get(name)
    ]
    return f" ({', '.join(differing)})" if differing else ""
