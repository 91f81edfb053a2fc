"""The pytest plugin in a codec author's repository: the lines of the documentation, run on the example distribution."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
from distributions import register
from project import DOCS, THIRD_PARTY

from codecbench.pytesting.baseline import Baseline

pytestmark = pytest.mark.thorough

# Times are given room here, where other tests may run beside; how small a slowdown is caught is for the benchmarks.
QUICK = "-p no:cacheprovider --benchmark-min-rounds=12 --benchmark-max-time=0.1 -k 'not TestPosterize'"
QUICK += " --codecbench-slower=60"
COMPARE = ["--benchmark-compare", "--benchmark-compare-fail=min:200%"]


@dataclass(frozen=True)
class Repository:
    """A codec author's folder, with the package installed from it."""

    folder: Path

    def pytest(self, *arguments: str, options: str = QUICK) -> subprocess.CompletedProcess[str]:
        # Not one of the processes in which these tests themselves may run: pytest-benchmark would not measure there.
        inherited = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_XDIST")}
        environment = {**inherited, "PYTHONPATH": str(self.folder), "PYTEST_ADDOPTS": options}
        command = [sys.executable, "-m", "pytest", *arguments]
        return subprocess.run(
            command, cwd=self.folder, env=environment, capture_output=True, text=True, check=False, timeout=300
        )

    def edit(self, old: str, new: str) -> None:
        """Change the codec's source."""
        path = self.folder / "codecbench_posterize" / "codec.py"
        source = path.read_text()
        assert source.count(old) == 1, old
        path.write_text(source.replace(old, new))

    @property
    def baseline(self) -> dict[str, dict[str, float]]:
        return json.loads((self.folder / "baseline.json").read_text())


def _copied(source: Path, target: Path) -> Repository:
    return Repository(Path(shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__"))))


def documented_commands() -> list[list[str]]:
    """The pytest commands of the section, without the word pytest."""
    page = (DOCS / "writing-a-codec.md").read_text()
    (block,) = re.findall(r"## Track regressions in five lines\n.*?```sh\n(.*?)```", page, re.DOTALL)
    assert len(block.splitlines()) == 5
    return [line.split()[1:] for line in block.splitlines() if line.startswith("pytest ")]


@pytest.fixture(scope="module")
def first_run(tmp_path_factory: pytest.TempPathFactory) -> Repository:
    """The repository after the first of the documented commands."""
    repository = _copied(THIRD_PARTY / "posterize", tmp_path_factory.mktemp("author") / "posterize")
    register(repository.folder, "codecbench-posterize", "0.3.0", "codecbench_posterize")
    done = repository.pytest(*documented_commands()[0])
    assert done.returncode == 0, done.stdout + done.stderr
    return repository


@pytest.fixture
def repository(first_run: Repository, tmp_path: Path) -> Repository:
    return _copied(first_run.folder, tmp_path / "posterize")


def test_the_first_run_keeps_times_sizes_and_psnrs(first_run: Repository) -> None:
    assert list(first_run.baseline) == ["posterize", "posterize bits=1", "posterize bits=8"]
    assert first_run.baseline["posterize bits=8"]["psnr_db"] == float("inf")
    assert 10 < first_run.baseline["posterize bits=1"]["psnr_db"] < first_run.baseline["posterize"]["psnr_db"] < 50
    (saved,) = (first_run.folder / ".benchmarks").glob("*/*.json")
    benchmarks = json.loads(saved.read_text())["benchmarks"]
    assert len(benchmarks) == 6
    for benchmark in benchmarks:
        facts = benchmark["extra_info"]
        assert facts["version"] == "1"
        assert facts["size_bytes"] == first_run.baseline[facts["codec"]]["size_bytes"]


def test_the_suite_and_the_benchmarks_run_together(first_run: Repository) -> None:
    done = first_run.pytest("--codecbench", "posterize bits=2", options="--benchmark-disable -k 'bits or bytes'")
    assert re.search(r"\d+ passed", done.stdout), done.stdout
    assert "failed" not in done.stdout


@pytest.mark.slow
def test_nothing_changed_is_nothing_failed(repository: Repository) -> None:
    before = repository.baseline
    done = repository.pytest(*documented_commands()[1])
    assert done.returncode == 0, done.stdout
    assert repository.baseline == before


def test_a_larger_file_fails(repository: Repository) -> None:
    repository.edit("zlib.compress(samples.tobytes())", "zlib.compress(samples.tobytes(), 0)")
    done = repository.pytest(
        "--codecbench", "posterize", "--codecbench-baseline", "baseline.json", "--benchmark-disable"
    )
    assert done.returncode == 1
    assert re.search(r"posterize bits=1: \d+ bytes; the baseline has \d+", done.stdout)


def test_a_loss_of_quality_fails(repository: Repository) -> None:
    repository.edit("values * step + step // 2", "values * step")
    done = repository.pytest(
        "--codecbench", "posterize", "--codecbench-baseline", "baseline.json", "--benchmark-disable"
    )
    assert done.returncode == 1
    assert re.search(r"posterize: PSNR \d+\.\d+ dB; the baseline has \d+", done.stdout)


def test_a_slowdown_fails(repository: Repository) -> None:
    repository.edit("        inflate = zlib", "        __import__('time').sleep(0.2)\n        inflate = zlib")
    done = repository.pytest("--codecbench", "posterize", *COMPARE, "--benchmark-min-rounds=3")
    assert done.returncode == 1
    assert "Performance has regressed" in done.stdout + done.stderr
    assert "test_decode[posterize]" in (done.stdout + done.stderr).split("Performance has regressed")[1]


@pytest.mark.slow
def test_a_slowdown_that_pytest_benchmark_allows_is_caught_in_units_of_the_yardstick(repository: Repository) -> None:
    once = "zlib.compress(samples.tobytes())"
    repository.edit(once, f"({once}, {once})[1]")
    arguments = ["--codecbench", "posterize bits=8", "--codecbench-baseline", "baseline.json"]
    done = repository.pytest(*arguments, options=QUICK.replace("=60", "=30"))
    output = done.stdout + done.stderr
    assert re.search(r"bits=8: encode takes \d+\.\d % longer|encode time is inconclusive", output), output


def test_a_new_setting_joins_the_baseline(repository: Repository) -> None:
    before = repository.baseline
    arguments = ["--codecbench", "posterize bits=3", "--codecbench-baseline", "baseline.json", "--benchmark-disable"]
    assert repository.pytest(*arguments).returncode == 0
    assert {**repository.baseline, "posterize bits=3": None} == {**before, "posterize bits=3": None}
    assert repository.baseline["posterize bits=3"]["size_bytes"] > 0


FACTS = {"codec": "mine q=1", "version": "1", "size_bytes": 900, "psnr_db": 31.5, "encode_operations": 1_000_000}


@pytest.mark.parametrize(
    ("changed", "numbers"),
    [
        ({}, []),
        ({"size_bytes": 899, "psnr_db": 31.6, "encode_operations": 999_999}, []),
        ({"size_bytes": 901}, ["901", "900"]),
        ({"psnr_db": 31.4}, ["31.4", "31.5"]),
        ({"encode_operations": 1_100_000}, ["1,100,000", "10.0", "1,000,000"]),
    ],
)
def test_sizes_psnrs_and_operations_are_compared_exactly(
    tmp_path: Path, changed: dict[str, float], numbers: list[str]
) -> None:
    first = Baseline(tmp_path / "baseline.json", 7.0, "one processor")
    assert first.complaint(FACTS) == ""
    first.save()
    complaint = Baseline(tmp_path / "baseline.json", 7.0, "one processor").complaint({**FACTS, **changed})
    assert re.findall(r"\d[\d.,]*", complaint.removeprefix("mine q=1: ")) == numbers


def test_times_of_another_processor_are_a_warning(tmp_path: Path) -> None:
    first = Baseline(tmp_path / "baseline.json", 7.0, "one processor")
    assert first.time_complaint("mine", "encode", lambda: sum(range(1000))) == ""
    first.save()
    again = Baseline(tmp_path / "baseline.json", 7.0, "another processor")
    with pytest.warns(UserWarning, match="^mine: .* one processor$"):
        assert again.time_complaint("mine", "encode", lambda: sum(range(100_000))) == ""


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ("posterise", "'posterize'"),
        ("posterize bits=9", "equal to 8"),
        ("posterize bits", "not KEY=VALUE"),
        ("posterize depth=2", "Extra inputs are"),
    ],
)
def test_usage_errors_say_what_is_wrong(first_run: Repository, value: str, said: str) -> None:
    done = first_run.pytest("--codecbench", value)
    assert done.returncode == pytest.ExitCode.USAGE_ERROR
    assert f"--codecbench {value}" in done.stderr
    assert said in done.stderr
    assert "Traceback" not in done.stderr


def test_a_baseline_that_cannot_be_written_stays_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "baseline.json"
    path.write_text('{"before": {}}\n')
    baseline = Baseline(path, 7.0, "a processor")
    baseline.complaint({"codec": "raw", "version": "1", "size_bytes": 10, "psnr_db": 40.0})

    def refuse(*_: object) -> None:
        raise OSError(28, "No space left on device", str(path))

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", refuse)
        with pytest.raises(OSError, match=r"device: .*baseline\.json"):
            baseline.save()
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [(path.name, '{"before": {}}\n')]
    baseline.save()
    assert set(json.loads(path.read_text())) == {"before", "raw"}
