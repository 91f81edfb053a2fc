"""Kept cells whose plugins were edited are told of, by the installed command, and neither dropped nor passed over."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from distributions import install_posterize, install_source
from installed_command import TINY, Done, Place, tiny_place

from codecbench.core.engine.identity import digest
from codecbench.core.engine.storage.record import bytes_from_record
from codecbench.core.engine.storage.store import Store

MATRIX = """
version: 1
name: m
sequences: [{use: synthetic, params: {stop: 2}}]
codecs: [posterize, raw]
evaluators: [EVALUATORS]
run: {workers: 1}
"""

pytestmark = pytest.mark.thorough


HELPED = """
import ed_helper
from plain_plugins import NULL_TRACE, Shift

from codecbench import PluginSpec, hookimpl


class Helped(Shift):
    name = "helped"

    def encode(self, image, *, trace=NULL_TRACE):
        return super().encode(ed_helper.prepared(image), trace=trace)


@hookimpl
def codecbench_codecs():
    return [PluginSpec("helped", "ed_one:Helped", "asks the module beside it")]
"""


def run(place: Place, *words: str, evaluators: str = "quality") -> Done:
    (place.folder / "m.yaml").write_text(MATRIX.replace("EVALUATORS", evaluators))
    done = place.call("run", "m.yaml", "--quiet", *words)
    assert done.status == 0, done.output
    return done


def kept(said: str, codec: str) -> int:
    """The number of cells that other code of that codec is said to have made."""
    (count,) = re.findall(rf"codec {codec}: other code .* (\d+) kept cell", said)
    return int(count)


@pytest.fixture
def place(tmp_path: Path) -> Place:
    """A folder with a finished run, whose plugin was then edited without another version."""
    place = Place(tmp_path)
    install_posterize(place.site)
    assert "other code" not in run(place).output
    assert "other code" not in run(place).output
    with (place.site / "codecbench_posterize" / "codec.py").open("a") as file:
        file.write("\nEDITED = True\n")
    return place


def test_an_edit_is_reported_until_its_cells_are_recomputed(place: Place) -> None:
    for _ in range(2):
        done = run(place)
        (line,) = [line for line in done.stderr.splitlines() if "other code" in line]
        assert line.startswith("codec posterize: ")
        assert line.endswith("codecbench run ... --recompute posterize")
        assert kept(line, "posterize") == 1
        assert "(codecbench-posterize 0.3.0: codec.py written" in line
        assert "2 of them" in done.stdout
    assert "1 of them" in run(place, "--recompute", "posterize").stdout
    assert "other code" not in run(place).output


def test_an_edit_of_a_module_beside_the_codec_is_told(tmp_path: Path) -> None:
    place = tiny_place(tmp_path)
    install_source(place.site, "ed-one", "1", HELPED)
    helper = place.site / "ed_helper.py"
    helper.write_text("def prepared(image):\n    return image\n")
    (tmp_path / "helped.yaml").write_text(TINY.replace("tiny", "helped").replace("shift", "helped"))
    for told in (False, True):
        assert place.call("run", "helped.yaml", "--quiet").status == 0
        assert ("other code" in place.call("run", "helped.yaml", "--quiet").stderr) == told
        helper.write_text("def prepared(image):\n    return image | 1\n")
    said = place.call("run", "helped.yaml", "--quiet").stderr
    assert kept(said, "helped") == 1
    assert f"(ed-one 1: {helper.name} written" in said
    assert "--recompute helped" in said


@pytest.mark.slow
def test_new_cells_on_bitstreams_of_other_code_do_not_hide_it(place: Place) -> None:
    run(place, "--recompute", "quality")
    assert kept(run(place).stderr, "posterize") == 1
    run(place, evaluators="quality, features")
    assert kept(run(place, evaluators="quality, features").stderr, "posterize") == 2


def test_the_report_says_which_code_made_what(place: Place) -> None:
    run(place, evaluators="quality, features")
    assert place.call("report", "runs/m").status == 0
    page = (place.folder / "runs/m/report/report.html").read_text()
    rows = re.findall(r"<td[^>]*>codec posterize</td>.*?</tr>", page)
    assert len(rows) == 2
    assert all("ran other code" in row for row in rows)
    assert len(re.findall(r"<td[^>]*>codec raw</td>.*?</tr>", page)) == 1


@pytest.mark.slow
def test_records_without_code_are_said_to_be_unknown_in_one_line(place: Place) -> None:
    store = Store(place.folder / "runs" / "m")
    for cell in store.read_plan().cells:
        path = store.record_folder(cell.id) / "record.json"
        body = json.loads(bytes_from_record(store.read_record(cell.id)))
        del body["code"], body["checksum"]
        path.write_text(json.dumps({"checksum": digest(body), **body}))
    (store.records_folder / "index.jsonl").unlink()
    done = run(place)
    assert re.search(r"\b2 of them", done.stdout)
    (line,) = [line for line in done.stderr.splitlines() if "unknown" in line]
    assert line.startswith("2 kept cell(s) ")
    assert "before codecbench recorded" in line
