"""Types and shell completions of command-line parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from codecbench.core.engine.plugins import registry

if TYPE_CHECKING:
    from codecbench.core.contracts.hooks import Kind


def codec_names(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    """Complete the name of an installed codec."""
    return _names(("codec",), incomplete)


def plugin_names(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    """Complete the name of an installed plugin of any kind."""
    return _names(("codec", "evaluator", "dataset", "slam_backend", "executor", "link"), incomplete)


def _names(kinds: tuple[Kind, ...], incomplete: str) -> list[str]:
    names = [plugin.spec.name for kind in kinds for plugin in registry.installed().plugins(kind)]
    return [name for name in dict.fromkeys(names) if name.startswith(incomplete)]


class Format(click.Choice[str]):
    """A choice of output formats. `md` means `markdown`."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        return super().convert("markdown" if value == "md" and "markdown" in self.choices else value, param, ctx)
