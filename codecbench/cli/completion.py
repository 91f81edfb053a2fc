"""What a shell offers where a name of a plugin is wanted."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from codecbench.core.engine.plugins import registry

if TYPE_CHECKING:
    from codecbench.core.contracts.hooks import Kind


def codec_names(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    """Codecs that are installed and begin so."""
    return _names(("codec",), incomplete)


def plugin_names(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    """Codecs, evaluators and other plugins that are installed and begin so."""
    return _names(("codec", "evaluator", "dataset", "slam_backend", "executor", "link"), incomplete)


def _names(kinds: tuple[Kind, ...], incomplete: str) -> list[str]:

    names = [plugin.spec.name for kind in kinds for plugin in registry.installed().plugins(kind)]
    return [name for name in dict.fromkeys(names) if name.startswith(incomplete)]
