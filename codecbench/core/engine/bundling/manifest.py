"""What a bundle says of itself: which run it is, and the size and SHA-256 of every file; and what may be in one."""

from __future__ import annotations

import re
from typing import Annotated, Final, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from codecbench.core.engine.text import clean_line

FORMAT: Final = 1
MANIFEST: Final = "manifest.json"

MOST_FILES: Final = 400_000
"""A plan has at most 100,000 cells, and a cell leaves a record, its samples and a file or two."""
LARGEST_FILE: Final = 512_000_000
"""Bytes of a file that is read whole: records, samples, artifacts, the plan, the manifest."""
LARGEST_BITSTREAMS: Final = 32_000_000_000
"""Bytes of the bitstreams of one sequence, which are read frame by frame."""

_LONGEST_NAME: Final = 200
_ID: Final = "[0-9a-f]{32}"
_NAME: Final = re.compile(
    rf"matrix\.yaml|plan\.json|environment/[0-9a-f]{{8,64}}\.json|coded/{_ID}\.(bits|code)"
    r"|records/([0-9a-f]{2})/\2[0-9a-f]{30}/[^./\\][^/\\]*"
)
"""The files of a run folder that a bundle may hold: a name of another form is refused, not mended."""


def largest_bytes(name: str) -> int:
    """How large a file of this name may be."""
    return LARGEST_BITSTREAMS if name.endswith(".bits") and name.startswith("coded/") else LARGEST_FILE


def _checked_name(name: str) -> str:
    if not (_NAME.fullmatch(name) and name.isprintable() and len(name.encode()) <= _LONGEST_NAME):
        raise ValueError(f"{clean_line(name)!r} is no name of a file of a run")
    return name


FileName = Annotated[str, AfterValidator(_checked_name)]
"""A path inside a run folder, with `/`, of a file that a bundle may hold. Raises ValueError for any other."""

_Line = Annotated[str, AfterValidator(clean_line)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, extra="ignore")


class FileFacts(_Part):
    """Bytes and SHA-256 of a file."""

    size: int = Field(ge=0)
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")


class Manifest(_Part):
    """What is in a bundle.

    codecbench: the version that wrote it. cells: how many the plan has. statuses: how many have which status;
    those without a record are in none. bitstreams: whether what the codecs wrote is in it.
    """

    format: Literal[1] = FORMAT
    codecbench: _Line
    name: _Line
    cells: int = Field(ge=0)
    statuses: dict[_Line, int]
    bitstreams: bool
    files: dict[FileName, FileFacts]
