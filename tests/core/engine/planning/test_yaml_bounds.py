"""Matrices that ask for too much are refused at once: by commands with little memory, before the rest is read."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest
from installed_command import Done

from codecbench.core.contracts.errors import MatrixError
from codecbench.core.engine.planning.axes import axes, points
from codecbench.core.engine.planning.yaml_file import Problems, load_yaml, require_bounded

HEAD = "version: 1\nname: x\nsequences: [{use: synthetic, params: {frames: 4}}]\nevaluators: [quality]\n"
ALIASES = "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]\n" for n in range(1, 10))

BAD = {
    "alias bomb": (
        f"a0: &a0 [x, x]\n{ALIASES}codecs: *a9\n",
        "m.yaml:9:35: more than 20,000 values",
    ),
    "alias of what it is in": ("codecs: &all [raw, *all]\n", "m.yaml:5:20: *all "),
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
        "m.yaml:8:7: codecs[0].params: 100 x 100 x 200 = 2,000,000 settings; at most 100,000 are allowed",
    ),
    "range without end": (
        "codecs: [{use: jpeg_qf, params: {qf: {range: [0, 1.0e308, 1.0e-308]}}}]\n",
        "m.yaml:5:46: codecs[0].params.qf.range: must be [first, last, step > 0], 1 to 10000 values; got [0, 1e+308",
    ),
    "more cells than can be planned": (
        "codecs: [{use: jpeg_qf, params: {qf: {range: [1, 1000]}}}]\n",
        "1 sequences x 1,000 codecs x 1,200 evaluators = 1,200,000 cells; at most 1,000,000 are allowed",
    ),
}
"""The rest of each matrix after HEAD, and what is said of it."""
MATRICES = {name: HEAD + rest for name, (rest, _) in BAD.items()}
MATRICES["thousands of problems"] = HEAD + "codecs: [{use: jpeg_qf, params: {qf: {range: [1001, 3000]}}}]\n"
MATRICES["more cells than can be planned"] = MATRICES["more cells than can be planned"].replace(
    "[quality]", "[{use: timing, params: {frames: {range: [1, 1200]}, repeats: 5}}]"
)


PLANS_EACH = """
import json, sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from codecbench.cli import main
matrices, sys.argv = sys.stdin.readlines(), ["codecbench", "plan", "m.yaml"]
for matrix in matrices:
    Path("m.yaml").write_text(json.loads(matrix))
    with redirect_stdout(StringIO()) as out, redirect_stderr(StringIO()) as err:
        try:
            main()
            status = 0
        except SystemExit as ended:
            status = ended.code
    print(json.dumps([status, out.getvalue(), err.getvalue()]), flush=True)
"""


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Done]:
    """What `codecbench plan` says of each matrix: all in one process, with 2 GiB of address space."""

    def limits() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (2 << 30, 2 << 30))

    done = subprocess.run(
        [sys.executable, "-c", PLANS_EACH],
        input="".join(f"{json.dumps(text)}\n" for text in MATRICES.values()),
        cwd=tmp_path_factory.mktemp("planned"),
        env={**os.environ, "COLUMNS": "200", "OPENBLAS_NUM_THREADS": "1"},
        preexec_fn=limits, capture_output=True, text=True, timeout=500,
    )  # fmt: skip
    return {name: Done(*json.loads(line)) for name, line in zip(MATRICES, done.stdout.splitlines(), strict=False)}


@pytest.mark.parametrize("name", BAD)
def test_too_much_is_refused_with_its_place(planned: dict[str, Done], name: str) -> None:
    assert name in planned, "it, or one before it, took all the memory"
    done = planned[name]
    assert done.status == 2, done.output
    assert BAD[name][1] in done.stderr
    assert "Traceback" not in done.output
    assert len(done.output) < 1000


def test_aliases_merges_and_anchors_of_a_sane_matrix_are_taken(tmp_path: Path) -> None:
    path = tmp_path / "m.yaml"
    path.write_text("a: &a {x: 1, y: [2, 3]}\nb: *a\nc: {<<: *a, z: 4}\nd: &n 7\ne: [*n, *n]\n")
    _, root = load_yaml(path)
    assert root["b"]["y"] == [2, 3]
    assert dict(root["c"]) == {"z": 4, "x": 1, "y": [2, 3]}
    assert root["e"] == [7, 7]


def test_what_aliases_repeat_is_counted() -> None:
    text = "a: &a [{}]\nb: &b [{}]\nc: [{}]\n".format(", ".join(["1"] * 99), ", ".join(["*a"] * 99), "{}")
    require_bounded(text.replace("{}", ", ".join(["*b"] * 1)), "m.yaml")
    with pytest.raises(MatrixError, match=r"m\.yaml:3:.* 20,000 values"):
        require_bounded(text.replace("{}", ", ".join(["*b"] * 2)), "m.yaml")


@pytest.mark.parametrize(("lengths", "count"), [((10, 10), 100), ((100, 1000), 100_000), ((101, 1000), 0)])
def test_products_up_to_the_limit_are_spanned(lengths: tuple[int, int], count: int) -> None:
    problems = Problems("m.yaml")
    params = {f"p{place}": {"range": [1, length]} for place, length in enumerate(lengths)}
    assert sum(1 for _ in points(axes(params, ("codecs", 0), problems))) == count
    assert bool(problems.entries) == (count == 0)


def test_thousands_of_problems_are_not_all_spelled_out(planned: dict[str, Done]) -> None:
    done = planned["thousands of problems"]
    assert len(done.stderr.splitlines()) == 51
    assert done.stderr.splitlines()[-1] == "and 1950 more"


@pytest.mark.parametrize("opening", ["[", "{a: ", "- "], ids=["lists", "mappings", "blocks"])
def test_depth_is_refused_while_it_is_read(opening: str) -> None:
    """Soon after it comes what is no YAML: whoever stops at once does not find it."""
    with pytest.raises(MatrixError, match=r"m\.yaml:1:\d+: .* 64 levels"):
        require_bounded(opening * 200 + "@", "m.yaml")
