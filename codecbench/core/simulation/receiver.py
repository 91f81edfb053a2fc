"""The receiver: decodes what is whole, in order, and hands on what is not too old."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import accumulate
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.evaluator import SentPacket
from codecbench.core.simulation.settings import LinkSettings

FrameOutcome = Literal["on time", "concealed", "partial", "late", "lost", "broken", "skipped"]
"""`skipped`: not sent. `lost`: parts of it never came. `partial`: the same, handed on as far as it came. `broken`: it
came whole, and depends on one that did not. `concealed`: the same, handed on as the decoder makes it up. `late`: too
old to be of use, or after a newer one."""


def frame_outcomes(
    units: Mapping[int, SentPacket],
    captured_s: NDArray[np.float64],
    complete_s: Mapping[int, float],
    settings: LinkSettings,
    partial_s: Mapping[int, float] = MappingProxyType({}),
) -> tuple[list[FrameOutcome], NDArray[np.float64]]:
    """What became of each frame, and (N,) when it was handed on; infinite where it was not.

    units: by number, in order. captured_s: (N,) of frames. complete_s: of the units that were sent, by number; infinite
    for those that never were. partial_s: when what there is of these can be decoded, where a decoder makes something of
    it. A frame that the encoder gave nothing for was skipped.
    """
    if settings.transport == "reliable":
        complete_s = _in_order(complete_s)
    outcomes: list[FrameOutcome] = ["skipped"] * len(captured_s)
    decodable_s = np.full(len(captured_s), math.inf)
    in_time: list[FrameOutcome] = ["on time"] * len(captured_s)
    begun_s, whole_from, session = math.inf, math.inf, 0
    for number, unit in units.items():
        if unit.session != session:  # which has a decoder of its own
            begun_s, whole_from, session = math.inf, math.inf, unit.session
        own_s = complete_s.get(number, math.inf)
        if math.isinf(own_s):
            whole_from = math.inf
        elif unit.starts:
            begun_s, whole_from = own_s, -math.inf
        else:
            if unit.recovery_frames is not None:  # of what was lost before nothing is left once the refresh is round
                begun_s = own_s if math.isinf(begun_s) else begun_s
                whole_from = min(whole_from, unit.frame + unit.recovery_frames)
            begun_s = max(begun_s, own_s)
        is_broken = unit.frame < whole_from
        if number in partial_s:
            decodable_s[unit.frame], in_time[unit.frame] = partial_s[number], "partial"
            continue
        if math.isinf(own_s):
            outcomes[unit.frame] = "lost" if number in complete_s else "skipped"
            continue
        outcomes[unit.frame] = "broken" if is_broken else "late"
        if not is_broken or settings.concealed:
            decodable_s[unit.frame] = begun_s
            in_time[unit.frame] = "concealed" if is_broken else "on time"
    decoded_s = _decoded(list(units.values()), captured_s, decodable_s, settings)
    handed_s = np.full(len(captured_s), math.inf)
    newest = -1
    for frame in sorted(np.flatnonzero(np.isfinite(decoded_s)).tolist(), key=lambda frame: (decoded_s[frame], frame)):
        if frame > newest and decoded_s[frame] - captured_s[frame] <= settings.deadline_s:
            newest, handed_s[frame] = frame, decoded_s[frame]
            outcomes[frame] = in_time[frame]
        else:
            outcomes[frame] = "late"
    return outcomes, handed_s


def _in_order(complete_s: Mapping[int, float]) -> dict[int, float]:
    """Nothing of a reliable transport is there before all that was sent before it is."""
    numbers = sorted(complete_s)
    return dict(zip(numbers, accumulate((complete_s[number] for number in numbers), max), strict=True))


def _decoded(
    units: Sequence[SentPacket],
    captured_s: NDArray[np.float64],
    decodable_s: NDArray[np.float64],
    settings: LinkSettings,
) -> NDArray[np.float64]:
    """(N,) when the decoder gives each frame. It decodes one after the other.

    Of pictures that stand alone it leaves out those that are too old already. Where pictures of a stream are sent in
    another order than shown, each waits for those before it.
    """
    stands_alone = all(unit.starts for unit in units)
    given_s, free_s = np.full(len(captured_s), math.inf), 0.0
    for frame in np.lexsort((np.arange(len(decodable_s)), decodable_s)).tolist():
        begun_s = max(free_s, decodable_s[frame])
        if math.isinf(begun_s) or (stands_alone and begun_s - captured_s[frame] > settings.deadline_s):
            continue
        free_s = given_s[frame] = begun_s + settings.decode_s
    frames = [unit.frame for unit in units]
    if frames != sorted(frames):
        present = np.flatnonzero(np.isfinite(given_s))
        given_s[present] = np.maximum.accumulate(given_s[present])
    return given_s
