"""Offers the dataset `npy` to codecbench."""

from codecbench import PluginSpec, hookimpl


@hookimpl
def codecbench_datasets() -> list[PluginSpec]:
    return [PluginSpec("npy", "codecbench_npy.dataset:Npy", "frames in one NumPy file")]
