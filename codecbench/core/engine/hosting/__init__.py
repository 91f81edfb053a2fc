"""Processes in which other people's plugins are imported, so that the program itself never imports them."""

from typing import Final

HOSTED_VARIABLE: Final = "CODECBENCH_HOSTED"
"""Set in hosts, so that a plugin that calls codecbench at import does not import itself recursively."""
