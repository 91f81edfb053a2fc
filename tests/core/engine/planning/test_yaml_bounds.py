"""Matrices that ask for too much are refused at once: by the installed command, with little memory and time."""

from __future__ import annotations

import resource
import time
from pathlib import Path

import pytest
from installed_command import Done, Place

from codecbench.core.contracts.errors import MatrixError
from codecbench.core.engine.planning.axes import axes, points
from codecbench.core.engine.planning.yaml_bounds import MOST_CHARACTERS, require_bounded
from codecbench.core.engine.planning.yaml_file import Problems, load

HEAD = "version: 1\nname: x\nsequences: [{use: synthetic, params: {frames: 4}}]\nevaluators: [quality]\n"
ALIASES = "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]\n" for n in range(1, 10))

BAD = {
    "alias bomb": (
        f"a0: &a0 [x, x]\n{ALIASES}codecs: *a9\n",
        "m.yaml:9:35: more than 20,000 values up to here, counting what aliases repeat",
    ),
    "alias of what it is in": ("codecs: &all [raw, *all]\n", "m.yaml:5:20: *all stands inside what it stands for"),
    "deep list": (f"codecs: {'[' * 5000}{']' * 5000}\n", "m.yaml:5:73: more than 64 levels deep"),
    "deep mapping": (f"codecs: {'{a: ' * 5000}1{'}' * 5000}\n", "levels deep"),
    "unknown tag": ("codecs: [!!python/object/apply:os.system [ls]]\n", "m.yaml:5:10: tag 'tag:yaml.org,2002:python"),
    "tag of its own": ("codecs: [!codec raw]\n", "m.yaml:5:10: tag '!codec': a matrix has plain values only"),
    "list as a key": ("codecs: [{use: raw, params: {[a]: 1}}]\n", "m.yaml:5:30: a list or mapping cannot be a key"),
    "mapping as a key": ("? {a: 1}\n: [raw]\n", "m.yaml:5:3: a list or mapping cannot be a key"),
    "number without end": (f"codecs: [{'9' * 5000}]\n", "m.yaml:5:10: a number of 5,000 digits"),
    "long": (f"codecs: [{'raw, ' * 300_000}]\n", "longer than 1,000,000 characters"),
    "many values": (f"codecs: [{'r, ' * 30_000}]\n", "more than 20,000 values"),
    "two million settings": (
        "codecs:\n  - use: multilevel\n    params:\n      qf: {range: [1, 100]}\n      levels: {range: [1, 100]}\n"
        "      keys: {range: [1, 200]}\n",
        "m.yaml:8:7: codecs[0].params: 100 x 100 x 200 = 2,000,000 settings; at most 100,000 are planned",
    ),
    "range without end": (
        "codecs: [{use: jpeg_qf, params: {qf: {range: [0, 1.0e308, 1.0e-308]}}}]\n",
        "m.yaml:5:46: codecs[0].params.qf.range: must be [first, last, step > 0], 1 to 10000 values; got [0, 1e+308",
    ),
}


def called(folder: Path, text: str) -> Done:
    """`codecbench plan` of a matrix, with 2 GiB of address space and seconds of processor time, starting included."""
    (folder / "m.yaml").write_text(text)

    def limits() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (2 << 30, 2 << 30))
        resource.setrlimit(resource.RLIMIT_CPU, (6, 6))

    return Place(folder).call("plan", "m.yaml", limits=limits, timeout=60, OPENBLAS_NUM_THREADS="1")


@pytest.mark.parametrize("name", BAD)
def test_too_much_is_refused_with_its_place(tmp_path: Path, name: str) -> None:
    text, said = BAD[name]
    done = called(tmp_path, HEAD + text)
    assert done.status == 2, done.output
    assert said in done.stderr
    assert "Traceback" not in done.output
    assert len(done.output) < 1000


def test_aliases_merges_and_anchors_of_a_sane_matrix_are_taken(tmp_path: Path) -> None:
    path = tmp_path / "m.yaml"
    path.write_text("a: &a {x: 1, y: [2, 3]}\nb: *a\nc: {<<: *a, z: 4}\nd: &n 7\ne: [*n, *n]\n")
    _, root = load(path)
    assert root["b"]["y"] == [2, 3]
    assert dict(root["c"]) == {"z": 4, "x": 1, "y": [2, 3]}
    assert root["e"] == [7, 7]


def test_what_aliases_repeat_is_counted() -> None:
    text = "a: &a [{}]\nb: &b [{}]\nc: [{}]\n".format(", ".join(["1"] * 99), ", ".join(["*a"] * 99), "{}")
    require_bounded(text.replace("{}", ", ".join(["*b"] * 1)), "m.yaml")
    with pytest.raises(MatrixError, match=r"m\.yaml:3:.*more than 20,000 values"):
        require_bounded(text.replace("{}", ", ".join(["*b"] * 2)), "m.yaml")


@pytest.mark.parametrize(("lengths", "count"), [((10, 10), 100), ((100, 1000), 100_000), ((101, 1000), 0)])
def test_products_up_to_the_limit_are_spanned(lengths: tuple[int, int], count: int) -> None:
    problems = Problems("m.yaml")
    params = {f"p{place}": {"range": [1, length]} for place, length in enumerate(lengths)}
    assert sum(1 for _ in points(axes(params, ("codecs", 0), problems))) == count
    assert bool(problems.found) == (count == 0)


def test_thousands_of_problems_are_not_all_spelled_out(tmp_path: Path) -> None:
    done = called(tmp_path, HEAD + "codecs: [{use: jpeg_qf, params: {qf: {range: [1001, 3000]}}}]\n")
    assert done.status == 2
    assert len(done.stderr.splitlines()) == 51
    assert done.stderr.splitlines()[-1] == "and 1950 more"


def test_more_cells_than_can_be_planned_are_refused_with_their_number(tmp_path: Path) -> None:
    codecs = "codecs: [{use: jpeg_qf, params: {qf: {range: [1, 1000]}}}]\n"
    evaluators = "evaluators: [{use: timing, params: {frames: {range: [1, 1200]}, repeats: 5}}]\n"
    done = called(tmp_path, HEAD.replace("evaluators: [quality]\n", evaluators) + codecs)
    assert done.status == 2
    assert (
        "1 sequences x 1,000 codecs x 1,200 evaluators = 1,200,000 cells; at most 1,000,000 are planned" in done.stderr
    )


@pytest.mark.parametrize(("opening", "closing"), ["[]", ("{a: ", "}"), ("- ", "")], ids=["lists", "mappings", "blocks"])
def test_depth_is_refused_while_it_is_read(opening: str, closing: str) -> None:
    text = opening * 200_000 + "1" + closing * 200_000
    begun = time.process_time()
    with pytest.raises(MatrixError, match=r"m\.yaml:1:\d+: more than 64 levels deep"):
        require_bounded(text[:MOST_CHARACTERS], "m.yaml")
    assert time.process_time() - begun < 0.2
