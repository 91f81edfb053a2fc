"""A dask cluster behind TLS, as docs/security.md sets it up: who has the key gets in, and nobody else."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from dask_cluster import Cluster, cluster_elsewhere
from installed_command import Done, Place
from project import DOCS

pytest.importorskip("distributed", reason="the extra codecbench[dask] is not installed")
pytestmark = pytest.mark.thorough

MATRIX = """
version: 1
name: tls
sequences: [{use: folder, params: {path: pictures}}]
codecs: [png]
evaluators: [quality]
run: {workers: 1, executor: {use: dask, params: {address: "ADDRESS", shared_files: true, start_timeout_s: TIMEOUT}}}
"""
PAGE = (DOCS / "security.md").read_text()


def shown(language: str) -> str:
    """The one block of a language on the page."""
    (block,) = re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)
    return str(block)


def credentials(folder: Path) -> Path:
    """Make a key and a certificate in a new folder, and the settings that name them, as the page says."""
    folder.mkdir()
    subprocess.run(["bash", "-euc", shown("bash")], cwd=folder, check=True, capture_output=True)
    settings = folder / "tls.yaml"
    settings.write_text(shown("yaml").replace("/home/me/dask", str(folder)))
    assert (folder / "key.pem").stat().st_mode & 0o77 == 0
    return settings


@dataclass(frozen=True)
class Guarded:
    """A cluster behind TLS, and a folder with pictures to run on."""

    place: Place
    cluster: Cluster
    settings: Path

    def run(self, name: str, settings: Path | None, address: str = "", timeout_s: int = 60) -> Done:
        text = MATRIX.replace("ADDRESS", address or self.cluster.address).replace("TIMEOUT", str(timeout_s))
        (self.place.folder / f"{name}.yaml").write_text(text)
        nothing = self.place.folder / "nothing.yaml"
        nothing.write_text("{}")
        return self.place.call(
            "run", f"{name}.yaml", "--out", name, "--quiet", DASK_CONFIG=str(settings or nothing), timeout=120
        )


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guarded]:
    place = Place(tmp_path_factory.mktemp("tls"))
    (place.folder / "pictures").mkdir()
    picture = np.random.default_rng(1).integers(0, 256, (32, 48, 3), np.uint8)
    cv2.imwrite(str(place.folder / "pictures" / "0.png"), picture)
    settings = credentials(place.folder / "ours")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DASK_CONFIG", str(settings))
        with cluster_elsewhere(place.folder / "cluster", place.site, workers=1, protocol="tls") as cluster:
            yield Guarded(place, cluster, settings)


def test_a_run_with_the_key_gets_in(guarded: Guarded) -> None:
    assert guarded.cluster.address.startswith("tls://127.0.0.1:")
    done = guarded.run("with", guarded.settings)
    assert done.status == 0, done.output
    assert "1 ok" in done.stdout


@pytest.mark.parametrize("credential", ["none", "another"])
def test_a_run_without_the_key_is_refused(credential: str, guarded: Guarded, tmp_path: Path) -> None:
    settings = credentials(tmp_path / "theirs") if credential == "another" else None
    done = guarded.run(credential, settings, timeout_s=5)
    assert done.status == 3, done.output
    assert f"dask worker at {guarded.cluster.address}" in done.stderr
    assert not list((guarded.place.folder / credential / "records").glob("*/*/record.json"))
    log = (guarded.place.folder / "cluster" / "s.log").read_text()
    assert credential == "none" or "certificate" in log.lower() or "ssl" in log.lower()


LOCAL = """
from codecbench.plugins.executors.dask import DaskExecutor, DaskParams

executor = DaskExecutor(DaskParams())
executor.start(1, print)
print(executor._cluster.scheduler_address)
executor.stop()
"""


def test_a_cluster_of_a_run_uses_tls_where_it_is_set_up(guarded: Guarded) -> None:
    environment = guarded.place.environment(DASK_CONFIG=str(guarded.settings))
    done = subprocess.run([sys.executable, "-c", LOCAL], env=environment, capture_output=True, text=True, timeout=120)
    assert done.stdout.startswith("tls://127.0.0.1:"), done.stderr


def test_plain_connections_are_refused(guarded: Guarded) -> None:
    plain = guarded.cluster.address.replace("tls://", "tcp://")
    done = guarded.run("plain", None, plain, timeout_s=5)
    assert done.status == 3, done.output
    assert f"dask worker at {plain}" in done.stderr
