"""`codecbench list` and `codecbench schema`."""

from __future__ import annotations

import json
from typing import Any

import click

from codecbench.cli.messages import say
from codecbench.cli.parameters import plugin_names
from codecbench.core.contracts.hooks import KINDS, Kind
from codecbench.core.engine.planning import schema as json_schema
from codecbench.core.engine.plugins.plugin import Plugin
from codecbench.core.engine.plugins.registry import Registry, installed
from codecbench.core.engine.text import clean_line

_PLURALS: dict[str, Kind] = {f"{kind}s": kind for kind in KINDS}


@click.command("list")
@click.argument("kinds", nargs=-1, type=click.Choice([*_PLURALS, "slam-backends"]))
@click.option("--json", "as_json", is_flag=True, help="Print JSON for programs to read.")
def list_plugins(kinds: tuple[str, ...], as_json: bool) -> None:
    """List installed plugins: all, or those of the KINDS given."""
    registry = installed()
    selected = [_PLURALS[kind.replace("-", "_")] for kind in kinds] or list(KINDS)
    plugins = {kind: registry.plugins(kind) for kind in selected}
    if as_json:
        click.echo(json.dumps(_rows(plugins, registry), indent=2))
        return
    for kind, group in plugins.items():
        click.secho(f"{kind.replace('_', ' ')}s", bold=True)
        width = max((len(plugin.spec.name) for plugin in group), default=0)
        for plugin in group:
            origin = "" if plugin.distribution.startswith("codecbench ") else f"  [{plugin.distribution}]"
            line = f"  {plugin.spec.name:<{width}}  {clean_line(plugin.spec.summary)}{origin}"
            say(line, indent=width + 4)
            if plugin.missing:
                say(f"      not available: {plugin.missing}", indent=6)
        if not group:
            click.echo("  none")
    for problem in registry.problems:
        say(f"problem: {problem}", fg="yellow", err=True)


def _rows(plugins: dict[Kind, list[Plugin]], registry: Registry) -> dict[str, Any]:
    rows: dict[str, Any] = {
        f"{kind}s": [
            {
                "name": plugin.spec.name,
                "summary": plugin.spec.summary,
                "target": plugin.spec.target,
                "distribution": plugin.distribution,
                "missing": plugin.missing,
            }
            for plugin in group
        ]
        for kind, group in plugins.items()
    }
    rows["problems"] = [str(problem) for problem in registry.problems]
    return rows


@click.command()
@click.argument("plugin", required=False, shell_complete=plugin_names)
def schema(plugin: str | None) -> None:
    """Print JSON Schema: of a whole matrix, or of the parameters of one PLUGIN.

    An editor that knows the schema can complete and check a matrix as you type. If plugins of two kinds share a name,
    write KIND:NAME (codec:raw).
    """
    registry = installed()
    value = json_schema.plugin_schema(registry, plugin) if plugin else json_schema.matrix_schema(registry)
    click.echo(json.dumps(value, indent=2))
