"""The fingerprint of a plugin's code follows its files, or what was installed, and nothing else."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from distributions import install_posterize, install_source

from codecbench.core.contracts.hooks import PluginSpec
from codecbench.core.engine.plugins.fingerprint import _imported_files, _outside_core, code_digest, code_of, files_since
from codecbench.core.engine.plugins.plugin import Plugin
from codecbench.core.engine.plugins.registry import installed

POSTERIZE = Plugin("codec", PluginSpec("posterize", "codecbench_posterize.codec:Posterize", ""),
                   "codecbench-posterize 0.3.0", hosted=True)  # fmt: skip


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder on the path with a distribution that has no list of what was installed."""
    for name in [name for name in sys.modules if name.partition(".")[0] == "codecbench_posterize"]:
        monkeypatch.delitem(sys.modules, name)  # of a test before: what is imported is found where it was
    install_posterize(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


def append(path: Path, text: str) -> None:
    """Write more into a file, at a time of its own."""
    with path.open("a") as file:
        file.write(text)
    os.utime(path, (path.stat().st_mtime + 10,) * 2)


def test_an_edit_changes_the_fingerprint_and_undoing_it_brings_it_back(site: Path) -> None:
    before = code_of(POSTERIZE)
    path = site / "codecbench_posterize" / "codec.py"
    text = path.read_text()
    append(path, "X = 1\n")
    assert code_of(POSTERIZE) != before
    path.write_text(text)
    assert code_of(POSTERIZE) == before
    assert before.startswith("codecbench-posterize 0.3.0 ")
    assert "codecbench_posterize" not in sys.modules


def test_data_in_the_package_counts_and_bytecode_does_not(site: Path) -> None:
    before = code_of(POSTERIZE)
    cache = site / "codecbench_posterize" / "__pycache__"
    cache.mkdir()
    (cache / "codec.cpython-311.pyc").write_bytes(b"compiled")
    assert code_of(POSTERIZE) == before
    (site / "codecbench_posterize" / "levels.txt").write_text("1 2 4")
    assert code_of(POSTERIZE) != before


def test_files_that_were_written_since_are_named(site: Path) -> None:
    path = site / "codecbench_posterize" / "codec.py"
    append(path, "X = 1\n")
    assert files_since(POSTERIZE, path.stat().st_mtime - 1) == ["codec.py"]
    assert files_since(POSTERIZE, path.stat().st_mtime + 1) == []


def test_of_copied_files_the_version_and_the_list_count(site: Path) -> None:
    record = next(site.glob("*.dist-info")) / "RECORD"
    record.write_text("codecbench_posterize/codec.py,sha256=abc,10\ncodecbench_posterize-0.3.0.dist-info/METADATA,,\n")
    before = code_of(POSTERIZE)
    append(site / "codecbench_posterize" / "codec.py", "X = 1\n")
    assert code_of(POSTERIZE) == before
    record.write_text("codecbench_posterize/codec.py,sha256=abd,10\n")
    after = code_of(POSTERIZE)
    assert after != before
    (record.parent / "direct_url.json").write_text('{"url": "file:///x", "dir_info": {"editable": true}}')
    assert code_of(POSTERIZE) not in (before, after)


@pytest.mark.parametrize("depth", [0, 1], ids=["beside", "in a package beside"])
def test_modules_that_the_plugin_leads_to_count_and_others_in_the_folder_do_not(site: Path, depth: int) -> None:
    helper = site / "tools" / "rounding.py" if depth else site / "rounding.py"
    (site / "tools").mkdir()
    (site / "tools" / "__init__.py").write_text("from . import rounding\n" if depth else "")
    helper.write_text("import json\nSTEP = 1\n")
    (site / "unrelated.py").write_text("")
    append(site / "codecbench_posterize" / "codec.py", "import tools\n" if depth else "from rounding import STEP\n")
    before = code_of(POSTERIZE)
    append(site / "unrelated.py", "X = 1\n")
    assert code_of(POSTERIZE) == before
    append(helper, "STEP = 2\n")
    assert code_of(POSTERIZE) != before
    assert "rounding.py" in files_since(POSTERIZE, helper.stat().st_mtime - 1)


def test_beside_what_pip_installs_lie_the_modules_of_others(
    site: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shared = tmp_path / "site-packages"
    shared.mkdir()
    monkeypatch.syspath_prepend(str(shared))
    install_source(shared, "lonely", "1", "import other_library\n")
    lonely = Plugin("codec", PluginSpec("lonely", "lonely:Codec", ""), "lonely 1", hosted=True)
    before = code_of(lonely)
    (shared / "other_library.py").write_text("")
    assert code_of(lonely) == before


def test_a_module_that_cannot_be_read_as_python_counts_as_a_file(site: Path) -> None:
    path = site / "codecbench_posterize" / "codec.py"
    path.write_text("def broken(:\n")
    before = code_of(POSTERIZE)
    append(path, "X = 1\n")
    assert code_of(POSTERIZE) != before


def test_a_plugin_that_is_not_there_has_no_fingerprint() -> None:
    assert code_of(Plugin("codec", PluginSpec("gone", "nowhere:Found", ""), "gone 1.0", hosted=True)) == ""


def test_of_ours_only_what_the_plugin_consists_of_counts(tmp_path: Path) -> None:
    files = {
        "plugins/codecs/mine.py": "from codecbench.plugins.codecs.shared import tables\nimport codecbench.core.image\n",
        "plugins/codecs/shared/__init__.py": "",
        "plugins/codecs/shared/tables.py": "def f():\n    import codecbench.slam.points\n",
        "plugins/codecs/shared/table.npz": "numbers",
        "plugins/codecs/other.py": "",
        "slam/points.py": "",
        "slam/kernels.json": "{}",
        "core/image.py": "",
    }
    for name, text in files.items():
        path = tmp_path / "codecbench" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    found = _imported_files("codecbench.plugins.codecs.mine", tmp_path, _outside_core)
    names = {path.relative_to(tmp_path / "codecbench").as_posix() for path in found}
    others = {"plugins/codecs/other.py", "slam/kernels.json", "core/image.py"}
    assert names == files.keys() - others


def test_our_plugins_have_fingerprints_of_their_own() -> None:
    registry = installed()
    jpeg, raw = (code_of(registry.find("codec", name)) for name in ("jpeg", "raw"))
    assert jpeg.rpartition(" ")[2] != raw.rpartition(" ")[2]
    assert jpeg.startswith("codecbench ")


def test_the_digest_of_several_is_that_of_their_fingerprints() -> None:
    assert code_digest({}) == ""
    assert code_digest({"codec a": "a 1 x"}) == code_digest({"codec a": "a 2 x"})
    assert code_digest({"codec a": "a 1 x"}) != code_digest({"codec a": "a 1 y"})
    assert code_digest({"codec a": "a 1 x"}) != code_digest({"codec b": "a 1 x"})
