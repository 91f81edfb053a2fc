"""The GitHub Action of action.yml: its steps, as a runner would start them, with a GitHub made of a file."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import yaml
from installed_command import TINY, plain_place
from kept_runs import write_kept_run
from project import DOCS, ROOT
from warm_command import COMMAND

ACTION: dict[str, Any] = yaml.safe_load((ROOT / "action.yml").read_text())
STEPS: dict[str, dict[str, Any]] = {step["id"]: step for step in ACTION["runs"]["steps"]}
MARKER = "<!-- codecbench: codecbench -->\n"

GH = f"""#!{sys.executable}
import json, pathlib, sys
import jq
comments, calls = (pathlib.Path(__file__).parent / name for name in ("comments.json", "calls"))
words = sys.argv[2:]
with calls.open("a") as file:
    print(json.dumps(words), file=file)
option = lambda name: words[words.index(name) + 1] if name in words else None
had = json.loads(comments.read_text())
if "--method" not in words:
    print(*jq.compile(option("--jq")).input_value(had).all(), sep="\\n")
    sys.exit()
body = pathlib.Path(option("--field").removeprefix("body=@")).read_text()
place = [word for word in words if word.startswith("repos/")][0].split("/")[3:]
if option("--method") == "POST" and place == ["issues", "7", "comments"]:
    had.append({{"id": 100 + len(had), "body": body}})
elif option("--method") == "PATCH" and place[:2] == ["issues", "comments"]:
    next(one for one in had if one["id"] == int(place[2]))["body"] = body
else:
    sys.exit(f"HTTP 404: {{words}}")
comments.write_text(json.dumps(had))
"""
"""`gh api`, as far as comments of pull request 7 go. It answers from a file beside it, and writes down its calls."""


@dataclass
class Runner:
    """A machine that runs steps of the action. `values` are those of the expressions that steps use."""

    folder: Path
    environment: dict[str, str]
    values: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, one in ACTION["inputs"].items():
            self.values[f"inputs.{name}"] = one.get("default", "")
        self.values |= {"inputs.token": "secret", "github.event.pull_request.number": "7"}
        (self.folder / "bin").mkdir()
        (self.folder / "bin/gh").write_text(GH)
        (self.folder / "bin/gh").chmod(0o755)
        self.tell({"id": 5, "body": f"Whoever cites {MARKER} is no comment of the action."})

    def run(self, name: str, status: int = 0) -> str:
        """Run a step as the shell `bash` of a runner does; return what it printed."""
        step = STEPS[name]
        assert step["shell"] == "bash"
        (self.folder / "script").write_text(step["run"])
        for file in ("output", "summary"):
            (self.folder / file).touch()
        own = {key: re.sub(r"\$\{\{ (.*?) \}\}", self._value, str(text)) for key, text in step["env"].items()}
        github = {
            "RUNNER_TEMP": str(self.folder), "GITHUB_ACTION_PATH": str(ROOT), "GITHUB_REPOSITORY": "me/mine",
            "GITHUB_OUTPUT": str(self.folder / "output"), "GITHUB_STEP_SUMMARY": str(self.folder / "summary"),
            "PATH": f"{self.folder / 'bin'}:{os.environ['PATH']}",
        }  # fmt: skip
        done = subprocess.run(
            ["bash", "--noprofile", "--norc", "-eo", "pipefail", self.folder / "script"],
            cwd=self.folder, env=self.environment | github | own, capture_output=True, text=True, timeout=600,
        )  # fmt: skip
        assert done.returncode == status, done.stdout + done.stderr
        for line in (self.folder / "output").read_text().splitlines():
            key, _, text = line.partition("=")
            self.values[f"steps.{name}.outputs.{key}"] = text
        (self.folder / "output").unlink()
        return done.stdout

    def _value(self, expression: re.Match[str]) -> str:
        return self.values[expression[1]]

    @property
    def comments(self) -> list[dict[str, Any]]:
        return json.loads((self.folder / "bin/comments.json").read_text())  # type: ignore[no-any-return]

    def tell(self, *comments: dict[str, Any]) -> None:
        (self.folder / "bin/comments.json").write_text(json.dumps(comments))

    @property
    def changes(self) -> list[str]:
        """The requests that change something."""
        calls = [json.loads(line) for line in (self.folder / "bin/calls").read_text().splitlines()]
        return [" ".join(words[2:4]) for words in calls if "--method" in words]


def test_a_second_run_updates_the_comment_of_the_first(tmp_path: Path) -> None:
    write_kept_run(tmp_path / "kept")
    runner = Runner(tmp_path, dict(os.environ))
    (tmp_path / "codecbench/bin").mkdir(parents=True)
    (tmp_path / "codecbench/bin/codecbench").symlink_to(COMMAND)
    runner.values["steps.run.outputs.folder"] = str(tmp_path / "kept")
    runner.run("table")
    table = (tmp_path / "codecbench-reports/codecbench/table.md").read_text()
    assert "| ramp | shifts | q=2 | 1.50 | 1.25 | ok |" in table
    assert (tmp_path / "summary").read_text() == table

    runner.run("comment")
    assert [one["id"] for one in runner.comments] == [5, 101]
    assert runner.comments[1]["body"] == MARKER + table

    report = Path(runner.values["steps.table.outputs.folder"])
    (report / "table.md").write_text("ä" * 99 + "\n" + "| a row of the table |\n" * 10_000)
    runner.run("comment")
    assert [one["id"] for one in runner.comments] == [5, 101]
    *lines, empty, last = runner.comments[1]["body"].splitlines()
    assert 64_900 < len(runner.comments[1]["body"].encode()) <= 65_000
    assert lines[:2] == [MARKER.strip(), "ä" * 99]
    assert set(lines[2:]) == {"| a row of the table |"}
    assert (empty, last) == ("", "The rest is in the summary of the job.")
    assert runner.changes == ["POST repos/me/mine/issues/7/comments", "PATCH repos/me/mine/issues/comments/101"]


def test_inputs_are_text_and_a_pull_request_without_the_permission_is_a_warning(tmp_path: Path) -> None:
    runner = Runner(tmp_path, dict(os.environ))
    runner.values["inputs.name"] = "\"$(touch pwned)`touch pwned` ' .[] | halt"
    runner.values["steps.table.outputs.folder"] = str(tmp_path)
    (tmp_path / "table.md").write_text("a table\n")
    assert runner.run("comment") == ""
    assert runner.run("comment") == ""
    assert [one["body"] for one in runner.comments[1:]] == [
        f"<!-- codecbench: {runner.values['inputs.name']} -->\na table\n"
    ]
    assert not (tmp_path / "pwned").exists()
    runner.values["github.event.pull_request.number"] = "8"  # not one that this GitHub has
    runner.tell()
    assert runner.run("comment").startswith("::warning::codecbench: no comment")


def test_every_input_is_used_and_every_output_is_one_of_an_earlier_step() -> None:
    text = (ROOT / "action.yml").read_text()
    assert set(re.findall(r"inputs\.([\w-]+)", text)) == set(ACTION["inputs"])
    assert "${{" not in "".join(step.get("run", "") for step in STEPS.values())
    for place, step in enumerate(STEPS.values()):
        assert set(re.findall(r"steps\.(\w+)", str(step))) <= set([*STEPS][:place])
    named = set(re.findall(r"steps\.(\w+\.outputs\.[\w-]+)", text))
    written = {f"{name}.outputs.{key}" for name, step in STEPS.items()
               for key in re.findall(r'echo "(\w+)=.*" >>"\$GITHUB_OUTPUT"', step.get("run", ""))}  # fmt: skip
    assert named == {"python.outputs.python-path", *written}


def test_the_workflow_of_the_page_gives_inputs_that_the_action_has() -> None:
    (block,) = re.findall(r"```yaml\n(.*?)```", (DOCS / "install.md").read_text(), re.DOTALL)
    workflow = yaml.safe_load(block)
    (job,) = workflow["jobs"].values()
    (step,) = [step for step in job["steps"] if "/codecbench@" in step["uses"]]
    required = {name for name, one in ACTION["inputs"].items() if one.get("required")}
    assert required <= set(step["with"]) <= set(ACTION["inputs"])
    assert job.get("permissions", workflow.get("permissions"))["pull-requests"] == "write"


@pytest.mark.slow
def test_all_steps_in_their_order_with_an_installation_and_a_baseline(tmp_path: Path) -> None:
    place = plain_place(tmp_path)
    runner = Runner(tmp_path, place.environment())
    (tmp_path / "tiny.yaml").write_text(TINY)
    runner.values |= {"steps.python.outputs.python-path": sys.executable, "inputs.matrix": "tiny.yaml"}
    runner.values["inputs.extras"] = "bag"
    runner.values["inputs.plugins"] = str(ROOT / "tests/third_party/posterize")
    for name in ("install", "run", "table", "report", "comment"):
        runner.run(name)
    assert "posterize" in subprocess.check_output([tmp_path / "codecbench/bin/codecbench", "list"], text=True)
    report = Path(runner.values["steps.table.outputs.folder"])
    assert {path.name for path in report.iterdir()} == {"table.md", "report.html", "baseline.json", "comment.md"}

    baseline = (report / "baseline.json").rename(tmp_path / "baseline.json")
    runner.values["inputs.baseline"] = str(baseline)
    runner.run("table")
    assert "same: all" in (report / "table.md").read_text()
    head, *series = map(json.loads, baseline.read_text().splitlines())
    for one in series:
        one["values"] = [value + (-1 if one["better"] == "lower" else 1) for value in one["values"]]
    baseline.write_text("\n".join(map(json.dumps, [head, *series])))
    runner.run("table", status=1)
    assert "worse" in (report / "table.md").read_text()

    runner.values.pop("steps.run.outputs.folder")
    runner.values |= {"inputs.matrix": "--no-such-file.yaml", "inputs.name": "other"}
    runner.run("run", status=2)
    assert "steps.run.outputs.folder" not in runner.values
