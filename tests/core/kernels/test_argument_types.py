"""Types of arguments as text: what is written is read back, and nothing else is."""

from __future__ import annotations

import re
from collections import namedtuple

import numpy as np
import pytest
from numba import typeof, types

from codecbench.core.kernels.manifest import ArgumentTypeError, text_from_types, types_from_text

View = namedtuple("View", "pixels count")
VALUES = {
    "int64": 3,
    "float64": 0.5,
    "bool": True,
    "none": None,
    "uint8[::1]": np.zeros(3, np.uint8),
    "float64[:, ::1]": np.zeros((2, 3)),
    "float64[::1, :]": np.zeros((2, 3)).T,
    "float64[:]": np.zeros(6)[::2],
    "float32[:, :, ::1]": np.zeros((2, 3, 4), np.float32),
    "(int64, float64)": (1, 2.0),
    "(float64, float64, float64)": (1.0, 2.0, 3.0),
    "(int64,)": (1,),
    f'named("{__name__}:View", float64[:, ::1], int64)': View(np.zeros((2, 2)), 3),
}


@pytest.mark.parametrize("text", VALUES)
def test_the_type_of_a_value_is_written_and_read(text: str) -> None:
    found = typeof(VALUES[text])
    assert text_from_types((found,)) == text
    if not text.startswith("named"):  # by a module that can be imported: see below
        assert types_from_text(text) == (found,)


def test_named_tuples_are_found_by_their_class() -> None:
    name = "codecbench.slam.map.observation_kernels:Links"
    text = f'named("{name}", int64[::1], int64[::1], int32[:, ::1], int64[:, ::1], bool[::1])'
    (found,) = types_from_text(text)
    assert found.instance_class.__name__ == "Links"
    assert text_from_types((found,)) == text


def test_read_only_arrays_and_omitted_arguments_are_types_of_their_own() -> None:
    fixed = np.zeros(3)
    fixed.flags.writeable = False
    found = (typeof(fixed), types.Omitted(7), typeof(2))
    assert text_from_types(found) == "readonly(float64[::1]), omitted(7), int64"
    assert types_from_text("readonly(float64[::1]), omitted(7), int64") == found
    assert types_from_text("") == ()


@pytest.mark.parametrize(
    "text", ["float65", "float64[::2]", "open('x')", "float64[", "named('os:path')", "int64 + int64"]
)
def test_what_names_no_type_is_refused(text: str) -> None:
    with pytest.raises(ArgumentTypeError, match=f"^{re.escape(repr(text))} "):
        types_from_text(text)


def test_what_has_no_text_is_refused() -> None:
    with pytest.raises(ArgumentTypeError, match="unicode_type"):
        text_from_types((types.unicode_type,))
