"""Plugins come in through entry points; a bad one is named and harms nobody."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from distributions import install_posterize, install_source

from codecbench.core.contracts.errors import PluginError
from codecbench.core.contracts.hooks import KINDS
from codecbench.core.engine.plugins.registry import installed

HOOK_MODULE = """
from codecbench import PluginSpec, hookimpl

@hookimpl
def codecbench_{hook}():
    return [PluginSpec({name!r}, {target!r}, "a test", requires={requires!r}, extra={extra!r})]
"""


def hook_module(hook: str = "codecs", name: str = "mine", target: str = "json:JSONEncoder", **more: object) -> str:
    return HOOK_MODULE.format(
        hook=hook, name=name, target=target, requires=more.get("requires", ()), extra=more.get("extra", "")
    )


def listed(site: Path) -> dict[str, list[dict[str, str]]]:
    """What `codecbench list` says where `site` is installed too."""
    environment = {**os.environ, "PYTHONPATH": str(site)}
    command = [sys.executable, "-m", "codecbench", "list", "--json"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=300)
    return json.loads(done.stdout)


def names(plugins: list[dict[str, str]]) -> list[str]:
    return [plugin["name"] for plugin in plugins]


def test_our_own_plugins_come_through_the_same_door_without_problems() -> None:
    registry = installed()
    assert registry.problems == []
    for kind in KINDS:
        assert registry.plugins(kind), kind


@pytest.mark.parametrize("kind", KINDS)
def test_every_plugin_of_ours_that_is_available_loads(kind: str) -> None:
    registry = installed()
    for plugin in registry.plugins(kind):  # type: ignore[arg-type]
        if plugin.missing is None:
            assert registry.load(plugin.kind, plugin.spec.name).name == plugin.spec.name


def test_a_third_party_codec_shows_up(tmp_path: Path) -> None:
    install_posterize(tmp_path)
    row = next(row for row in listed(tmp_path)["codecs"] if row["name"] == "posterize")
    assert row["distribution"] == "codecbench-posterize 0.3.0"
    assert row["missing"] is None


def test_listing_imports_no_codec(tmp_path: Path) -> None:
    code = "import sys; from codecbench.cli import cli; cli(['list'], standalone_mode=False)"
    check = "; print(*[m for m in ('numpy', 'cv2', 'numba', 'pandas') if m in sys.modules], file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code + check], capture_output=True, text=True, check=True, timeout=300)
    assert done.stderr.strip() == ""


BAD = [
    ("import nothing_of_this_name", "does not import: ModuleNotFoundError"),
    ("raise RuntimeError('broken on purpose')", "broken on purpose"),
    ("x = 1", "implements no hook"),
    (hook_module("codec"), "codecbench_codec, which is not a hook; did you mean codecbench_codecs?"),
    (hook_module(name="raw"), "codec 'raw' is already offered by codecbench"),
    (hook_module(name="Not A Name"), "is not of the form"),
    (hook_module(target="no_colon"), "is not package.module:Class"),
    (hook_module().replace("[PluginSpec", "['x', PluginSpec"), "returned 'x'; it must return a list of PluginSpec"),
    (hook_module().replace("return [", "return [][0], ["), "codecbench_codecs failed: IndexError"),
]


def test_bad_distributions_are_reported_and_the_rest_works(tmp_path: Path) -> None:
    for number, (source, _) in enumerate(BAD):
        install_source(tmp_path, f"bad-{number}", "1.2", source)
    install_posterize(tmp_path)
    rows = listed(tmp_path)
    for number, (_, words) in enumerate(BAD):
        said = [problem for problem in rows["problems"] if f"bad-{number} 1.2" in problem]
        assert words in str(said)
    assert {"raw", "jpeg", "posterize"} <= set(names(rows["codecs"]))
    assert next(row for row in rows["codecs"] if row["name"] == "raw")["distribution"].startswith("codecbench ")


def test_a_distribution_is_imported_once_and_where_no_other_is(tmp_path: Path) -> None:
    log = tmp_path / "imported"
    told = f"import os\nopen({str(log)!r}, 'a').write(f'{{__name__}} {{os.getpid()}}\\n')\n"
    for name in ("mine", "other"):
        install_source(tmp_path, name, "1", told + hook_module(name=name))
    assert listed(tmp_path)["problems"] == []
    imported = dict(line.split() for line in log.read_text().splitlines())
    assert sorted(imported) == ["mine", "other"]
    assert len(log.read_text().splitlines()) == len(set(imported.values())) == 2


def test_a_plugin_that_needs_more_says_what_to_install(tmp_path: Path) -> None:
    install_source(tmp_path, "needy", "1", hook_module(requires=("nothing_of_this_name",), extra="needy[all]"))
    row = next(row for row in listed(tmp_path)["codecs"] if row["name"] == "mine")
    assert "install 'needy[all]'" in str(row["missing"])


def test_a_plugin_whose_library_is_too_old_says_what_to_upgrade(tmp_path: Path) -> None:
    install_source(tmp_path, "needy", "1", hook_module(requires=("numpy",), extra="needy[all]"))
    (metadata,) = tmp_path.glob("needy-1.dist-info/METADATA")
    metadata.write_text(metadata.read_text().rstrip() + "\nRequires-Dist: numpy>=99; extra == 'all'\n")
    row = next(row for row in listed(tmp_path)["codecs"] if row["name"] == "mine")
    assert f"numpy >=99, but {np.__version__} " in str(row["missing"])
    assert "--upgrade 'needy[all]'" in str(row["missing"])


def test_unknown_names_are_answered_with_the_nearest() -> None:
    with pytest.raises(PluginError, match="you mean 'jpeg2000'"):
        installed().find("codec", "jpg2000")


CODECS = "codecbench.Codec or codecbench.StreamCodec or codecbench.FeatureCodec"
INCOMPLETE = """
from codecbench import AnyCodec, Capabilities, Codec, FeatureCodec, NoParams, StreamCodec


class Vague(Codec):
    name, version, params_type = "vague", "1", NoParams

    def encode(self, image, *, trace=None):
        return image.tobytes()

    def decode(self, bitstream, *, trace=None):
        return None


class Half(Codec):
    name, version, params_type, capabilities = "half", "1", NoParams, Capabilities()

    def encode(self, image, *, trace=None):
        return image.tobytes()


class Neither(AnyCodec):
    name, version, params_type, capabilities = "neither", "1", NoParams, Capabilities()


class Mute(StreamCodec):
    name, version, params_type, capabilities = "mute", "1", NoParams, Capabilities()

    def encoder(self, frame_rate_hz):
        return None


class Blind(FeatureCodec):
    name, version, params_type, capabilities = "blind", "1", NoParams, Capabilities()

    def encoder(self):
        return None
"""


TARGETS = {
    "encoder": ("json:JSONEncoder", f"not a subclass of {CODECS}"),
    "neither": ("incomplete:Neither", f"not a subclass of {CODECS}"),
    "mute": ("incomplete:Mute", "incomplete:Mute does not define decoder"),
    "blind": ("incomplete:Blind", "incomplete:Blind does not define decoder, extract"),
    "nowhere": ("no_such_module_here:Thing", "does not import"),
    "vague": ("incomplete:Vague", "incomplete:Vague has no class attribute 'capabilities'"),
    "half": ("incomplete:Half", "incomplete:Half does not define decode"),
}
LOADING = """
import sys
from codecbench.core.engine.plugins.registry import installed

for name in sys.argv[1:]:
    try:
        installed().load("codec", name)
    except Exception as error:
        print(f"{type(error).__name__}: {error}".replace("\\n", " "))
    else:
        print("was loaded")
"""


def test_a_target_that_breaks_the_contract_is_named(tmp_path: Path) -> None:
    (tmp_path / "incomplete.py").write_text(INCOMPLETE)
    for name, (target, _) in TARGETS.items():
        install_source(tmp_path, f"liar-{name}", "1", hook_module(name=name, target=target))
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    command = [sys.executable, "-c", LOADING, *TARGETS]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    for (name, (_, words)), said in zip(TARGETS.items(), done.stdout.splitlines(), strict=True):
        assert said.startswith("PluginError: "), said
        assert words in said
        assert f"liar-{name} 1" in said
