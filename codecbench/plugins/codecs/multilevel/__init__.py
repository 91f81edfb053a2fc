"""The multi-level codec of Salih and Vasarhelyi."""

from codecbench.plugins.codecs.multilevel.codec import Multilevel, Sizes, describe
from codecbench.plugins.codecs.multilevel.params import MultilevelParams

__all__ = ["Multilevel", "MultilevelParams", "Sizes", "describe"]
