"""Finding the files that a plan from elsewhere names in a folder of one's own."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from codecbench.core.contracts.errors import DatasetError

SAME_PLACE: Final = "same"
"""Says that sequences are opened where the plan names them."""


def relocated(value: Any, folder: Path) -> Any:
    """A parameter that is a path, as it is called in `folder`; others as they are. Raises DatasetError."""
    if not isinstance(value, str) or "/" not in value:
        return value
    home, parts = folder.resolve(), [part for part in Path(value).parts if part not in ("/", "..")]
    for start in range(len(parts)):
        path = home.joinpath(*parts[start:])
        if path.exists() and path.resolve().is_relative_to(home):
            return str(path)
    raise DatasetError(f"{parts[-1] if parts else value} is not in {folder}")
