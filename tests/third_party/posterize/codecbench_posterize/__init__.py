"""Offers the codec `posterize` to codecbench."""

from codecbench import Offer, hookimpl


@hookimpl
def codecbench_codecs() -> list[Offer]:
    return [Offer("posterize", "codecbench_posterize.codec:Posterize", "keeps the upper bits of each sample, deflated")]
