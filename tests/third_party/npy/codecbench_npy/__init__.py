"""Offers the dataset `npy` to codecbench."""

from codecbench import Offer, hookimpl


@hookimpl
def codecbench_datasets() -> list[Offer]:
    return [Offer("npy", "codecbench_npy.dataset:Npy", "frames in one NumPy file")]
