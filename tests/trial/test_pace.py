"""What is measured of a machine before anything is announced; how fast it is, no test can say."""

from __future__ import annotations

from pathlib import Path

from recordings import pictures

from codecbench.core.engine.plugins.registry import installed
from codecbench.trial.pace import measure_pace
from codecbench.trial.trial import open_recording


def test_the_pace_is_known_even_where_a_frame_cannot_be_read(tmp_path: Path) -> None:
    pictures(tmp_path, ["1.png", "2.png"])
    recording = open_recording(tmp_path)
    pace = measure_pace(installed(), recording)
    assert pace.slowness > 0.0
    assert pace.reading_ms > 0.0
    (tmp_path / "2.png").write_bytes(b"\0")
    assert measure_pace(installed(), recording).reading_ms > 0.0
