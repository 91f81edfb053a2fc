"""Offers the codec `corners` to codecbench."""

from codecbench import PluginSpec, hookimpl


@hookimpl
def codecbench_codecs() -> list[PluginSpec]:
    return [PluginSpec("corners", "codecbench_corners.codec:Corners", "OpenCV's ORB features, deflated")]
