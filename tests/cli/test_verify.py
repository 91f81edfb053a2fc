"""`codecbench verify`, corpora, and the checks as a pytest suite."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from distributions import install_posterize, install_source
from installed_command import Place
from project import DOCS, SUPPORT

from codecbench import BitstreamError, Image, ParamsError, StoreError
from codecbench.cli import cli
from codecbench.core.conformance.corpus import read_manifest, write_bitstreams
from codecbench.core.conformance.material import integer_image
from codecbench.core.conformance.sandbox import sandbox
from codecbench.core.conformance.settings import setting_from_text, setting_label
from codecbench.core.conformance.suite import CHECKS, checks_of
from codecbench.core.contracts.image import LAYOUTS
from codecbench.core.engine.plugins.registry import installed
from codecbench.plugins.codecs.raw import Raw
from codecbench.pytesting import CodecSuite

CORPUS_CODECS = ("raw", "png")


def verify(*arguments: str) -> Result:
    return CliRunner().invoke(cli, ["verify", *arguments])


@pytest.fixture
def broken(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Puts a broken codec in the place of raw."""
    monkeypatch.syspath_prepend(str(SUPPORT))
    import broken_codecs

    registry = installed()
    load = registry.load

    def replace(codec_class: str) -> None:
        replacement = getattr(broken_codecs, codec_class)
        monkeypatch.setattr(registry, "load", lambda kind, name: replacement if name == "raw" else load(kind, name))

    sandbox("encode").stop()
    sandbox("decode").stop()  # started anew, with the module's folder on the path
    return replace


def test_a_sound_codec_passes_every_check() -> None:
    done = verify("raw")
    assert done.exit_code == 0, done.output
    claimed = [check for check in checks_of("pictures") if check.name != "partial"]
    assert [line.split()[1] for line in done.output.splitlines() if line.startswith("  pass")] == [
        check.name for check in claimed
    ]
    assert done.output.splitlines()[-1] == f"{len(checks_of('pictures')) - 1} passed, 0 failed, 1 skipped"
    for check in claimed:
        assert check.proves in done.output


@pytest.mark.thorough
def test_what_a_codec_does_not_claim_is_skipped_with_the_reason() -> None:
    done = verify("jpeg_qf", "--settings", "qf=20 color=gray", "--only", "lossless", "--only", "params")
    assert done.exit_code == 0
    assert "jpeg_qf qf=20 color=gray" in done.output
    assert re.search(r"skip +lossless +this setting does not claim to be lossless", done.output)
    assert done.output.splitlines()[-1] == "1 passed, 0 failed, 1 skipped"


BROKEN = """
from broken_codecs import {0}
from codecbench import PluginSpec, hookimpl

class Broken({0}):
    name = "broken"

@hookimpl
def codecbench_codecs():
    return [PluginSpec("broken", "broken:Broken", "breaks the contract", requires={1!r})]
"""


def with_broken(folder: Path, codec_class: str, requires: tuple[str, ...] = ()) -> Place:
    """A place where the codec `broken` is installed."""
    place = Place(folder)
    install_source(place.site, "broken", "1", BROKEN.format(codec_class, requires))
    return place


@pytest.mark.thorough
def test_a_broken_codec_fails_with_the_place(tmp_path: Path) -> None:
    done = with_broken(tmp_path, "LosesARow").call("verify", "broken", "--only", "shape", "--only", "params")
    assert done.status == 1
    assert re.search(r"FAIL  shape .*\n +gray: decoding .*: got shape \(\d+, \d+\); expected shape", done.stdout)
    assert "pass  params" in done.stdout


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("codec_class", "said"),
    [
        ("Exits", "raised: SystemExit(0), which ends programs"),
        pytest.param("Interrupts", "raised: KeyboardInterrupt(), which ends programs", marks=pytest.mark.thorough),
        pytest.param("EndsItsProcess", "crashed: the process exited with status 0", marks=pytest.mark.thorough),
        pytest.param("KillsItself", "crashed: the process was killed by SIGKILL", marks=pytest.mark.thorough),
        ("Segfaults", "crashed: the process was killed by SIGSEGV"),
        pytest.param("NeverEnds", "hung: no answer within 6 s", marks=pytest.mark.thorough),
    ],
)
def test_a_codec_that_ends_or_stops_its_process_fails_its_check_alone(
    tmp_path: Path, codec_class: str, said: str
) -> None:
    place = with_broken(tmp_path, codec_class)
    begun = time.monotonic()
    done = place.call("verify", "broken", "raw", "--only", "params", "--only", "bytes", "--timeout", "6")
    assert done.status == 1, done.output
    broken, raw = re.split(r"^raw", done.stdout, flags=re.MULTILINE)
    assert re.search(r"pass  params.*\n  FAIL  bytes", broken)
    assert f"gray: {said}" in broken
    assert re.search(r"pass  params.*\n  pass  bytes", raw), "the next codec is checked as if nothing had been"
    assert raw.splitlines()[-1] == "3 passed, 1 failed, 0 skipped"
    assert done.stderr == ""
    assert time.monotonic() - begun < 60


@pytest.mark.thorough
def test_a_codec_that_ends_its_process_when_constructed_costs_itself(tmp_path: Path) -> None:
    done = with_broken(tmp_path, "EndsWhenConstructed").call("verify", "broken", "raw", "--only", "bytes")
    assert done.status == 1
    assert re.search(r"broken\n  FAIL  crashed: the process exited with status 0", done.stdout)
    assert "pass  bytes" in done.stdout


@pytest.mark.thorough
def test_after_a_check_that_hung_no_other_is_waited_for(tmp_path: Path) -> None:
    place = with_broken(tmp_path, "NeverEnds")
    done = place.call("verify", "broken", "--only", "bytes", "--only", "shape", "--only", "cut", "--timeout", "6")
    assert done.stdout.splitlines()[-1] == "0 passed, 1 failed, 2 skipped"
    assert "skip  shape           not run, because bytes hung" in done.stdout


@pytest.mark.thorough
def test_json_says_what_the_lines_say(tmp_path: Path) -> None:
    place = with_broken(tmp_path, "LosesARow")
    assert place.call("verify", "broken", "png", "--only", "shape", "--json", "results.json").status == 1
    results = json.loads((tmp_path / "results.json").read_text())
    assert results["summary"] == {"passed": 2, "failed": 1, "skipped": 0}
    assert [setting["codec"] for setting in results["settings"]] == ["broken", "png", "png"]
    broken, png, effort = results["settings"]
    assert broken["distribution"] == "broken 1"
    assert [check["status"] for check in broken["checks"]] == ["failed", "failed"]
    assert {check["layout"] for check in broken["checks"]} == {"gray", "color"}
    assert "expected shape" in broken["checks"][0]["reason"]
    assert effort["params"]["effort"] == 9
    assert set(png["libraries"]) == {"opencv", "libpng"}


def test_json_on_standard_output_stands_alone() -> None:
    done = verify("raw", "--only", "params", "--json", "-")
    assert json.loads(done.stdout)["summary"]["passed"] == 1
    assert "pass  params" in done.stderr


@pytest.mark.thorough
def test_an_unavailable_codec_is_skipped_with_its_remedy(tmp_path: Path) -> None:
    place = with_broken(tmp_path, "LosesARow", requires=("no_such_library",))
    done = place.call("verify", "--only", "params")
    assert done.status == 0, done.output
    assert re.search(r"broken\n  skip .*run: pip install no_such_library", done.stdout)
    named = place.call("verify", "broken", "--only", "params")
    assert named.status == 1, "a codec that was asked for by name must not pass unseen"
    assert "FAIL" in named.stdout


@pytest.mark.thorough
def test_the_tutorial_codec_passes_as_its_author_would_see(tmp_path: Path) -> None:
    install_posterize(tmp_path)
    command = [sys.executable, "-m", "codecbench", "verify", "posterize"]
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.splitlines()[-1] == f"{3 * len(checks_of('pictures')) - 5} passed, 0 failed, 5 skipped"
    assert done.stderr == ""


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--settings", "quality=5"), "exactly one CODEC"),
        (("jpeg", "--settings", "quality=500"), "less than or equal to 100"),
        (("jpeg", "--only", "nothing"), "'nothing' is not one of"),
        (("--write-corpus", "a", "--check-corpus", "b"), "not both"),
    ],
)
def test_usage_errors_say_what_is_wrong(arguments: tuple[str, ...], said: str) -> None:
    done = verify(*arguments)
    assert done.exit_code == 2
    assert said in done.output


def test_settings_are_read_as_yaml_and_shell_words() -> None:
    assert setting_from_text("quality=10 progressive=true keys='[0.5, 0.25]' table=flat") == {
        "quality": 10, "progressive": True, "keys": [0.5, 0.25], "table": "flat",
    }  # fmt: skip
    assert setting_label("jpeg", {"quality": 10}) == "jpeg quality=10"
    for wrong in ("quality", "=3", "a=1 a=2", "a='", "a=[1"):
        with pytest.raises(ParamsError):
            setting_from_text(wrong)


# corpora


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("corpus") / "new"
    done = verify(*CORPUS_CODECS, "--write-corpus", str(folder))
    assert done.exit_code == 0, done.output
    return folder


@pytest.fixture
def corpus(written: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(written, tmp_path / "corpus"))


@pytest.mark.thorough
def test_a_corpus_is_all_that_its_manifest_says(corpus: Path) -> None:
    entries = read_manifest(corpus)
    settings = sum(len(installed().load("codec", name).examples) for name in CORPUS_CODECS)
    assert len(entries) == settings * 3 * len(LAYOUTS)
    for entry in entries:
        assert hashlib.sha256((corpus / entry.file).read_bytes()).hexdigest() == entry.bitstream_sha256
    lossless = [entry for entry in entries if entry.codec == "raw"]
    for entry in lossless:
        picture = integer_image(entry.seed, *entry.shape, entry.bits)
        head = f"uint{entry.bits} {'x'.join(map(str, picture.shape))}\n".encode()
        assert hashlib.sha256(head + picture.tobytes()).hexdigest() == entry.pixels_sha256


def test_a_sound_corpus_passes(corpus: Path) -> None:
    done = verify("--check-corpus", str(corpus))
    assert done.exit_code == 0
    assert done.output == f"{len(read_manifest(corpus))} passed, 0 failed, 0 skipped\n"


def test_only_the_codecs_named_are_checked(corpus: Path) -> None:
    assert verify("raw", "--check-corpus", str(corpus)).output == "9 passed, 0 failed, 0 skipped\n"


def test_a_damaged_or_missing_bitstream_is_told_from_a_changed_decoder(corpus: Path) -> None:
    first, second = sorted((corpus / "png").iterdir())[:2]
    first.write_bytes(first.read_bytes() + b"\0")
    second.unlink()
    done = verify("--check-corpus", str(corpus))
    assert done.exit_code == 1
    assert done.output.count("the corpus is damaged") == 2
    assert done.output.splitlines()[-1].endswith("2 failed, 0 skipped")


def edited(corpus: Path, of: str, /, **fields: Any) -> None:
    """Change fields of all entries of a codec in the manifest."""
    manifest = json.loads((corpus / "manifest.json").read_text())
    for entry in manifest["entries"]:
        if entry["codec"] == of:
            entry.update(fields)
    (corpus / "manifest.json").write_text(json.dumps(manifest))


@pytest.mark.thorough
def test_a_decoder_that_gives_other_pixels_fails(corpus: Path, broken: Any) -> None:
    broken("NotLossless")
    done = verify("raw", "--check-corpus", str(corpus))
    assert done.exit_code == 1
    assert "decodes to other pixels" in done.output


def test_an_encoder_that_changed_without_a_new_version_fails(corpus: Path) -> None:
    edited(corpus, "png", params={"effort": 0})
    done = verify("png", "--check-corpus", str(corpus))
    assert done.exit_code == 1
    assert "encodes to other bytes, with the same version and libraries: raise `version`" in done.output


def test_an_encoder_that_changed_with_its_version_is_noted(corpus: Path) -> None:
    edited(corpus, "png", params={"effort": 0}, version="0")
    done = verify("png", "--check-corpus", str(corpus))
    assert done.exit_code == 0
    assert "encodes to other bytes (png 0 -> 1)" in done.output


def test_bitstreams_of_a_setting_that_is_gone_still_decode(corpus: Path) -> None:
    edited(corpus, "png", params={"speed": 3})
    done = verify("png", "--check-corpus", str(corpus))
    assert done.exit_code == 0
    assert "only decoded" in done.output


def test_a_codec_that_is_not_installed_is_skipped(corpus: Path) -> None:
    edited(corpus, "raw", codec="gone")
    done = verify("--check-corpus", str(corpus))
    assert "no codec is called 'gone'" in done.output
    assert done.output.splitlines()[-1].endswith("0 failed, 9 skipped")


@pytest.mark.thorough
@pytest.mark.parametrize(("codec_class", "said"), [("Segfaults", "SIGSEGV"), ("Exits", "SystemExit")])
def test_a_codec_that_ends_its_process_writes_no_corpus(tmp_path: Path, codec_class: str, said: str) -> None:
    done = with_broken(tmp_path, codec_class).call("verify", "broken", "--write-corpus", "corpus")
    assert done.status == 1, done.output
    assert re.search(rf"FAIL  broken, image 0 of \(1, 1\), gray: .*{said}", done.stdout)
    assert not (tmp_path / "corpus" / "manifest.json").exists()


@pytest.mark.thorough
def test_an_encoder_that_ends_its_process_fails_its_bitstreams(tmp_path: Path) -> None:
    place = with_broken(tmp_path, "ClaimsToCount")
    assert place.call("verify", "broken", "raw", "--write-corpus", "corpus").status == 0
    (place.site / "broken.py").write_text(BROKEN.format("KillsItself", ()))
    done = place.call("verify", "--check-corpus", "corpus")
    assert done.status == 1, done.output
    assert done.stdout.count("does not encode its image any more: crashed: the process was killed by SIGKILL") == 6
    assert done.stdout.splitlines()[-1] == "9 passed, 6 failed, 0 skipped"


def test_nothing_is_overwritten(corpus: Path) -> None:
    with pytest.raises(StoreError, match="not empty"):
        write_bitstreams(corpus, [], "")


def test_no_manifest_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="not the manifest"):
        read_manifest(tmp_path)


DIGESTS = {
    (1, 1, 1): "c4694f2e93d5c4e7",
    (17, 31, 1): "e958d0ab06469fc5",
    (88, 120, 3): "1bf748e1620a5d5f",
    (17, 31, 1, 16): "af4a74905bc46b1e",
}


def test_pictures_are_the_same_on_every_machine() -> None:
    """Hashes from the machine that introduced the generator; they change with its name only."""
    digests = {shape: hashlib.sha256(integer_image(2, *shape).tobytes()).hexdigest()[:16] for shape in DIGESTS}
    assert digests == DIGESTS


def test_a_picture_has_something_of_everything() -> None:
    image = integer_image(3, 88, 120, 3).astype(int)
    assert image.min() < 60
    assert image.max() > 190
    assert 5 < np.abs(np.diff(image, axis=1)).mean() < 40
    assert np.abs(image[..., 0] - image[..., 1]).mean() > 10


# the suite


class Forgetful(Raw):
    """Gives back one gray level too many, which is not lossless."""

    def decode(self, bitstream: bytes, **_: Any) -> Image:
        if len(bitstream) < 17:
            raise BitstreamError("short")
        return super().decode(bitstream) + np.uint8(1)


class TestRaw(CodecSuite):
    codec = Raw


def test_the_suite_fails_where_a_check_does() -> None:
    class Suite(CodecSuite):
        codec = Forgetful

    with pytest.raises(pytest.fail.Exception, match=r"settings that claim to be lossless are\ngray: decod"):
        Suite().test_lossless({})  # type: ignore[attr-defined]
    Suite().test_shape({})  # type: ignore[attr-defined]


def test_every_check_is_documented() -> None:
    page = (DOCS / "verify.md").read_text()
    rows = re.findall(r"^\| `(\w+)` \| (.*?) \| ([PSF ]+) \|", page, re.MULTILINE)
    assert rows == [
        (check.name, check.proves, " ".join(shape[0].upper() for shape in check.shapes)) for check in CHECKS
    ]


@pytest.mark.thorough
def test_a_codec_with_memory_is_verified_as_one() -> None:
    pytest.importorskip("av", reason="the extra `video` is not installed")
    done = verify("h264", "--settings", "gop=4")
    assert done.exit_code == 0, done.output
    said = re.findall(r"^  (pass|skip) +(\w+)", done.output, re.MULTILINE)
    assert [name for _, name in said] == [check.name for check in checks_of("stream")]
    assert [name for mark, name in said if mark == "skip"] == ["lossless"]


@pytest.mark.thorough
def test_a_corpus_is_written_without_codecs_with_memory_which_are_named(tmp_path: Path) -> None:
    pytest.importorskip("av", reason="the extra `video` is not installed")
    done = verify("raw", "mjpeg", "--write-corpus", str(tmp_path / "corpus"))
    assert done.exit_code == 0, done.output
    assert "single images" in done.output
    assert {entry.codec for entry in read_manifest(tmp_path / "corpus")} == {"raw"}
