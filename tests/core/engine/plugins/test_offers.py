"""What distributions offer is asked once, until their files change."""

from __future__ import annotations

import json
import re
from pathlib import Path

from distributions import install_source
from installed_command import Place

SOURCE = """
import pathlib
from codecbench import PluginSpec, hookimpl

with open(pathlib.Path(__file__).parent / "imports", "a") as file:
    file.write("one\\n")

@hookimpl
def codecbench_codecs():
    return [PluginSpec("counted", "counted:Counted", "SUMMARY", requires=REQUIRES)]
"""


class Counted:
    """A distribution that counts how often it was imported."""

    def __init__(self, folder: Path) -> None:
        self.place = Place(folder)
        self.cache = folder / "cache"
        install_source(self.place.site, "counted", "1", "")

    def offer(self, summary: str = "counts", requires: str = "()") -> None:
        source = SOURCE.replace("SUMMARY", summary).replace("REQUIRES", requires)
        (self.place.site / "counted.py").write_text(source)

    def listed(self) -> tuple[str, str | None, list[str]]:
        """Summary and what is missing as `codecbench list` tells them, and all problems."""
        found = json.loads(self.place.call("list", "codecs", "--json", CODECBENCH_CACHE=str(self.cache)).stdout)
        told = next((codec for codec in found["codecs"] if codec["name"] == "counted"), {})
        return told.get("summary", ""), told.get("missing"), found["problems"]

    @property
    def imports(self) -> int:
        return len((self.place.site / "imports").read_text().splitlines())


def test_a_distribution_is_asked_again_when_its_files_changed(tmp_path: Path) -> None:
    counted = Counted(tmp_path)
    counted.offer()
    assert [counted.listed() for _ in range(2)] == [("counts", None, [])] * 2
    assert counted.imports == 1
    counted.offer("counts again")
    assert [counted.listed()[0] for _ in range(2)] == ["counts again"] * 2
    assert counted.imports == 2


def test_what_is_missing_is_looked_for_each_time_and_imported_never(tmp_path: Path) -> None:
    counted = Counted(tmp_path)
    counted.offer(requires="('lately.inner',)")
    assert "needs lately.inner" in str(counted.listed()[1])
    package = counted.place.site / "lately"
    package.mkdir()
    (package / "__init__.py").write_text("raise SystemExit('imported')")
    assert "needs lately.inner" in str(counted.listed()[1])
    (package / "inner.py").write_text("")
    assert counted.listed() == ("counts", None, [])
    assert counted.imports == 1


def test_an_answer_that_no_file_can_hold_is_taken_and_not_remembered(tmp_path: Path) -> None:
    counted = Counted(tmp_path)
    counted.offer()
    module = counted.place.site / "counted.py"
    patch = "from codecbench.core.engine.plugins.registry import Registry\nRegistry.entry_point = lambda *_: {1}\n"
    module.write_text(module.read_text() + patch)
    assert [counted.listed() for _ in range(2)] == [("counts", None, [])] * 2
    assert counted.imports == 2


def test_an_answer_about_a_setting_that_is_nonsense_costs_that_setting(tmp_path: Path) -> None:
    counted = Counted(tmp_path)
    counted.offer()
    module = counted.place.site / "counted.py"
    module.write_text(
        f"{module.read_text()}\nimport codecbench.core.engine.plugins.serving as s\n"
        "s.call_function = lambda *_: {1}\n"
    )
    matrix = {
        "version": 1,
        "name": "m",
        "sequences": ["synthetic"],
        "codecs": ["raw", "counted"],
        "evaluators": ["quality"],
    }
    (tmp_path / "m.yaml").write_text(json.dumps(matrix))
    done = counted.place.call("plan", "m.yaml", "--cells", CODECBENCH_CACHE=str(counted.cache))
    assert (done.status, "Traceback" in done.output) == (0, False), done.output
    assert re.search(r"codec counted of counted 1: .*not valid JSON", done.output)


def test_neither_a_damaged_answer_nor_a_faulty_distribution_is_remembered(tmp_path: Path) -> None:
    counted = Counted(tmp_path)
    counted.offer()
    counted.listed()
    (kept,) = (counted.cache / "offers").iterdir()
    whole = json.loads(kept.read_text())
    for damaged in ("", "[]", "{}", json.dumps({**whole, "offers": {"plugins": [{"kind": 3}], "problems": []}})):
        kept.write_text(damaged)
        assert counted.listed() == ("counts", None, [])
    assert counted.imports == 5
    assert json.loads(kept.read_text()) == whole
    kept.unlink()
    (counted.place.site / "counted.py").write_text("raise RuntimeError('today')")
    assert "RuntimeError: today" in counted.listed()[2][0]
    assert not list(kept.parent.iterdir())
