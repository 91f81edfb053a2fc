"""Parameters of plugins: one pydantic model for each plugin is its schema, its validation and its identity."""

from __future__ import annotations

import os
from abc import ABC
from pathlib import Path
from typing import Annotated, Any, ClassVar, Generic, Self, TypeVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, ValidationInfo


class Params(BaseModel):
    """Base of every plugin's parameters: immutable, no unknown names, no silent conversions between kinds.

    Values other than the defaults are part of the identity of every cell that uses them. Two spellings of one setting
    must therefore validate to equal instances, and a new parameter with a default changes no identity.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True, allow_inf_nan=False)

    def identity(self) -> dict[str, Any]:
        """Return what distinguishes this setting, as JSON types. Override it to leave out what changes no result.

        Parameters at their default may stay: the engine leaves them out of identities.
        """
        return self.model_dump(mode="json")


class NoParams(Params):
    """Parameters of a plugin that has none."""


P = TypeVar("P", bound=Params)


class Configured(ABC, Generic[P]):
    """Base of plugins of every kind; an instance is one setting."""

    name: ClassVar[str]
    """As in matrix files."""
    version: ClassVar[str]
    """Raise it whenever results change, so that stored cells are recomputed."""
    params_type: ClassVar[type[Params]]

    def __init__(self, params: P) -> None:
        """Store the parameters. Override it to prepare tables; raise Unsupported if a library is missing."""
        self.params = params

    @classmethod
    def create(cls, **values: Any) -> Self:
        """Create an instance from keyword parameters: `Jpeg.create(quality=10)`."""
        return cls(cls.params_type(**values))  # type: ignore[arg-type]


def _expand(value: Any) -> Any:
    if not isinstance(value, str | Path):
        return value
    text = os.path.expandvars(str(value))
    if "${" in text:
        missing = text[text.index("${") :].split("}")[0] + "}"
        raise ValueError(f"environment variable {missing} is not set")
    return os.path.expanduser(text)


def _anchor(path: Path, info: ValidationInfo) -> Path:
    folder = (info.context or {}).get("relative_to")
    return path if path.is_absolute() or folder is None else Path(folder) / path


PathParam = Annotated[Path, BeforeValidator(_expand), AfterValidator(_anchor)]
"""A path in a matrix: `~` and `${VAR}` expand; relative paths start at the matrix file's folder.

Validation receives that folder as `context={"relative_to": ...}`."""
