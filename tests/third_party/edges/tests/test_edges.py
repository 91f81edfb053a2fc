from types import SimpleNamespace

import numpy as np
from codecbench_edges.evaluator import Edges

from codecbench import CodedFrame, Frame


def step(at: int) -> np.ndarray:
    """A dark and a bright half that meet at a column."""
    return np.where(np.arange(32) < at, 20, 200).astype(np.uint8) * np.ones((16, 1), np.uint8)


def measured(decoded: np.ndarray, folder) -> dict[str, float]:
    frame = CodedFrame(Frame(0, 0.0, step(16)), b"", decoded)
    context = SimpleNamespace(artifacts=folder)
    return {value.metric: value.value for value in Edges.create().evaluate([frame], context)}


def test_an_untouched_frame_keeps_every_edge(tmp_path) -> None:
    assert measured(step(16), tmp_path) == {"edges_kept": 1.0, "edges_made": 0.0, "edges_hold": 1.0}


def test_an_edge_that_moves_is_lost_and_another_made(tmp_path) -> None:
    assert measured(step(20), tmp_path) == {"edges_kept": 0.0, "edges_made": 1.0, "edges_hold": 0.0}


def test_a_flat_frame_has_no_edges_to_lose(tmp_path) -> None:
    found = measured(np.full((16, 32), 90, np.uint8), tmp_path)
    assert found == {"edges_kept": 0.0, "edges_made": 0.0, "edges_hold": 0.0}
