"""The former name of `codecbench.pytesting`."""

import warnings

from codecbench.pytesting import CodecSuite

__all__ = ["CodecSuite"]

warnings.warn("codecbench.testing is now codecbench.pytesting", DeprecationWarning, stacklevel=2)
