"""The multi-level codec of Salih and Vasarhelyi."""

from codecbench.plugins.codecs.multilevel.codec import Multilevel
from codecbench.plugins.codecs.multilevel.params import MultilevelParams
from codecbench.plugins.codecs.multilevel.sizes import Sizes, describe

__all__ = ["Multilevel", "MultilevelParams", "Sizes", "describe"]
