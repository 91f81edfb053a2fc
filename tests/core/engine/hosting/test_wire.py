"""Values arrive as they were sent, of the type that the contract names."""

from __future__ import annotations

import json
from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np
import pytest

from codecbench.core.contracts.evaluator import Measurement
from codecbench.core.contracts.features import Features
from codecbench.core.contracts.sequence import Frame
from codecbench.core.contracts.stream import LOST, Packet
from codecbench.core.engine.hosting.wire import pack, unpack


class NoObjects:
    obeys = False

    def refer(self, value: object) -> None:
        return None

    def resolve(self, named: dict[str, Any]) -> Any:
        raise AssertionError(named)


def sent(value: Any) -> Any:
    payload: list[bytes] = []
    packed = json.dumps(pack(value, NoObjects(), payload))
    return unpack(json.loads(packed), NoObjects(), memoryview(b"".join(payload)))


class Text(str):
    __slots__ = ()

    def __str__(self) -> str:
        return "another"


class Bytes(bytes):
    def __len__(self) -> int:
        return 0


class Picture(np.ndarray[Any, Any]):
    pass


class Pair(NamedTuple):
    one: int
    two: int


@pytest.mark.parametrize(
    ("value", "arrives"),
    [
        *((same, same) for same in (None, True, 0, -(2**70), 1.5, float("inf"), -0.0, "\u00e4\ud800\0")),
        *((same, same) for same in (b"", b"\0\xff", Packet(b"abc", 7, starts=False))),
        *((same, same) for same in ([1, (2, {"a": [b"x", b"yz"]})], {3: "x", (1, 2): None}, frozenset({1, "b"}), LOST)),
        *((same, same) for same in (Measurement("psnr", -float("inf"), stage="decode"),)),
        (Text("text"), "text"),
        (Bytes(b"bytes"), b"bytes"),
        ({1, 2}, frozenset({1, 2})),
        (np.float64(0.5), 0.5),
        (np.float32(0.0), 0.0),
        (np.int64(0), 0),
        (np.bool_(False), False),
        (np.str_("s"), "s"),
    ],
)  # fmt: skip
def test_a_value_arrives(value: Any, arrives: Any) -> None:
    found = sent(value)
    assert (type(found), repr(found)) == (type(arrives), repr(arrives))
    assert found == arrives


def test_no_number_stays_no_number() -> None:
    found = sent([float("nan"), Measurement("psnr", float("nan"), reason="it is flat")])
    assert repr(found) == repr([float("nan"), Measurement("psnr", float("nan"), reason="it is flat")])


@pytest.mark.parametrize(
    "array",
    [
        np.arange(24, dtype=np.uint8).reshape(2, 3, 4),
        np.asfortranarray(np.arange(12.0).reshape(3, 4)),
        np.arange(20, dtype=">i4")[::-2],
        np.array([np.nan, -np.inf, 0.5], np.float16),
        np.array(7, np.uint16),
        np.zeros((0, 2)),
        np.array([True, False]),
        np.array([1 + 2j]),
        np.arange(6, dtype=np.uint8).reshape(2, 3).view(Picture),
    ],
)
def test_an_array_arrives_as_one_that_can_be_written(array: Any) -> None:
    found = sent(array)
    assert type(found) is np.ndarray
    assert (found.dtype, found.shape) == (array.dtype, array.shape)
    assert found.tobytes() == array.tobytes()
    assert found.flags.writeable
    assert found.flags.c_contiguous


def test_a_frame_arrives_without_what_it_has_cached() -> None:
    frame = Frame(3, 0.1, np.arange(6, dtype=np.uint8).reshape(2, 3))
    frame.cached("sum", np.sum)
    found = sent((frame, frame))
    for one in found:
        assert (type(one), one.index, one.timestamp_s, one.cache) == (Frame, 3, 0.1, {})
        np.testing.assert_array_equal(one.image, frame.image)


@pytest.mark.parametrize("count", [0, 2])
def test_features_arrive(count: int) -> None:
    places, numbers = np.ones((count, 2)), np.full(count, np.nan)
    bits = np.arange(32 * count, dtype=np.uint8).reshape(count, 32)
    features = Features((8, 6), places, np.arange(count, dtype=np.int32), np.zeros(count), numbers, bits)
    found = sent(features)
    assert found.size == (8, 6)
    for name in [field.name for field in fields(Features)][1:]:
        np.testing.assert_array_equal(getattr(found, name), getattr(features, name), strict=True)


def test_a_generator_goes_on_where_it_was() -> None:
    rng = np.random.default_rng(5)
    rng.random(3)
    rng.spawn(2)
    found = sent(rng)
    assert found.random(4).tolist() == rng.random(4).tolist()
    assert [child.random() for child in found.spawn(2)] == [child.random() for child in rng.spawn(2)]


@pytest.mark.parametrize(
    ("value", "name"),
    [
        (object(), "object"),
        (Pair(1, 2), "Pair"),
        (1j, "complex"),
        (len, "builtin_function_or_method"),
        (np.array([None]), f"ndarray of dtype {np.dtype(object)}"),
        (np.zeros(2, [("a", "i4")]), "ndarray of dtype [('a', '<i4')]"),
    ],
)
def test_of_anything_else_the_name_of_its_type_arrives(value: Any, name: str) -> None:
    (found,) = sent([value])
    assert type(found).__name__ == name
    assert not vars(found)
