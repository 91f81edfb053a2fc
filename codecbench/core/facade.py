"""The Python interface: run a matrix, open a run, and plot, report, rank and bundle it."""

from __future__ import annotations

import logging
import math
from collections.abc import Collection, Iterable, Mapping
from html import escape
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

from codecbench.core.analysis.collect import open_run as open_data
from codecbench.core.analysis.ranking import Ranked, Ranking, rankings
from codecbench.core.analysis.run_result import RunResult
from codecbench.core.contracts.errors import DatasetError, ParamsError
from codecbench.core.contracts.evaluator import CodedSequence
from codecbench.core.engine.bundling.packing import folder_beside, unpack_bundle, write_bundle
from codecbench.core.engine.hosting.host import limit_s
from codecbench.core.engine.planning.matrix import matrix_from, read_matrix
from codecbench.core.engine.planning.model import PluginSetting
from codecbench.core.engine.plugins.registry import Registry
from codecbench.core.engine.running.coding.coded_frames import CodedFrames
from codecbench.core.engine.running.coding.position import WorkPosition
from codecbench.core.engine.running.frame_cache import MOST_BYTES
from codecbench.core.engine.running.run import Listener
from codecbench.core.engine.running.workbench import Workbench
from codecbench.core.engine.storage.bitstream_file import BitstreamFile
from codecbench.core.engine.storage.plan_file import PlanFile
from codecbench.core.engine.storage.store import Store
from codecbench.core.report.answers import Answers, answers
from codecbench.core.report.formatting import uninformative_notes
from codecbench.core.report.page import write_report
from codecbench.core.report.tables import format_value, notes, short_table
from codecbench.core.rounds.running import run_matrix

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Run(RunResult):
    """A `RunResult` with methods to plot, report and query it."""

    def _repr_html_(self) -> str:
        """Return the primary metrics as a table with notes, for notebooks."""
        table = short_table(self).to_html(index=False, na_rep="–", float_format=format_value)
        return "\n".join([str(table), *(f"<p>{escape(note)}</p>" for note in notes(self))])

    def plot(self, what: str = "", sequence: str | None = None) -> Figure:
        """Draw a figure of the run, such as `rate-ate` for the trajectory error over the rate.

        what: words of the two axes' metrics with a hyphen between; by default the primary metric over the rate.
        sequence: its name; by default the first. Raises ParamsError, with the choices, if there is no such figure.
        """
        from codecbench.core.report.figures import one_figure  # matplotlib takes half a second to load

        return one_figure(self, what, sequence)

    def report(self, path: str | Path | None = None, *, frames: Collection[int] = ()) -> Path:
        """Write the report as one HTML page and return its path, by default `report/report.html` in the run folder.

        frames: indices of the frames to show; by default a few. Raises ParamsError for one that does not exist.
        """
        page = self.folder / "report" / "report.html" if path is None else Path(path)
        write_report(self, page, frames=frames)
        return page

    @property
    def answer(self) -> Answers:
        """The recommendation: `str(run.answer)` is a sentence, and `run.answer.answers` has one for each codec."""
        return answers(self)

    def best(self, rate: float | None = None) -> Answers | Ranked:
        """Return the recommendation: without a rate a sentence for each codec, at a rate the codec.

        rate: in the unit of tables. Raises ParamsError if it is not a positive number or nothing can be ranked there.
        """
        if rate is None:
            return answers(self)
        if isinstance(rate, bool) or not isinstance(rate, Real) or not 0.0 < rate < math.inf:
            unit = "" if self.rate is None else f" in {self.rate.unit}"
            raise ParamsError(
                f"best({rate!r}): give a rate above 0{unit} as a number, or nothing for one sentence per codec; "
                "`wide` and `tidy` have all columns"
            )
        ranked_at_rate = rankings(self, brief=True, at=rate / self.rate.factor) if self.rate is not None else []
        for ranking in ranked_at_rate:
            if ranking.ranked:
                return ranking.recommended
        reasons = [reason for ranking in ranked_at_rate for reason in uninformative_notes(ranking)]
        reason = reasons[0] if reasons else "no two codecs have settings on both sides of it"
        raise ParamsError(f"no codec can be ranked at that rate: {reason}")

    def frames(self, codec: str, setting: str | Mapping[str, Any] = "", sequence: str | None = None) -> CodedSequence:
        """Return the frames of a codec setting with their decoded versions, from the bitstreams in the run folder.

        setting: as in the tables, `quality=10`, or parameters, {"quality": 10}; optional if there is only one. Opens
        the sequence. Raises ParamsError if the run has no such setting, and DatasetError if the sequence is no longer
        that of the run.
        """
        jobs = [job for job in self.plan.jobs if sequence in (None, job.sequence.name)]
        chosen = [job for job in jobs if job.codec.name == codec and _matches(job.codec, setting)]
        if len({job.codec for job in chosen}) != 1:
            choices = ", ".join(dict.fromkeys(f"{job.codec.name} {job.codec.label}".strip() for job in chosen or jobs))
            words = (f"{key}={value}" for key, value in setting.items()) if isinstance(setting, Mapping) else [setting]
            message = f"{codec} {', '.join(words)} is not one setting of the run; say which of {choices}"
            raise ParamsError(message.replace("  ", " "))
        elsewhere = PlanFile(self.folder).origin_elsewhere()
        if elsewhere is not None:
            raise DatasetError(f"the run was made in {elsewhere}, so the sequences that its plan names are not opened")
        job, plugins = chosen[0], Workbench(limit_s)
        sequence_frames = plugins.sequence(job.sequence, MOST_BYTES)
        coder = plugins.create(job.codec, job.id)
        bitstreams = BitstreamFile(Store(self.folder).coded_path(job.id), job.id)
        return CodedFrames(sequence_frames, coder, bitstreams, WorkPosition())

    def rank(self, rate: float | None = None) -> list[Ranking]:
        """Rank the codecs by each task on each sequence, at a rate in the unit of tables."""
        return rankings(self, at=None if rate is None or self.rate is None else rate / self.rate.factor)


def open_run(folder: str | Path, registry: Registry | None = None) -> Run:
    """Open the results in a run folder, also while the run continues.

    Damaged records are left out and logged; the next run computes them again. Raises StoreError for a folder that is
    not a run.
    """
    data = open_data(folder, registry)
    return Run(data.folder, data.plan, data.results, data.environments, data.schema)


def run(
    matrix: str | Path | Mapping[str, Any],
    *,
    out: str | Path | None = None,
    workers: int | None = None,
    recompute: Iterable[str] = (),
    listener: Listener | None = None,
    log_level: int = logging.INFO,
) -> Run:
    """Compute the missing cells of a matrix and return its results.

    matrix: a file, or its content as a dict, whose paths are relative to the working directory. out: the run
    folder, by default `runs/NAME`. workers: processes, by default what the matrix says. recompute: names of codecs,
    evaluators and sequences whose cells are computed again. listener: called with the progress after every job and
    cell. Cells that fail are rows of the result, not exceptions. Raises MatrixError for a
    wrong matrix, ParamsError for a name to recompute that it does not have, and StoreError for a folder that is in use.

    Workers are processes of their own, so a script that calls this needs no `if __name__ == "__main__"`.
    """
    parsed = matrix_from(matrix) if isinstance(matrix, Mapping) else read_matrix(matrix)
    summary = run_matrix(parsed, out, workers=workers, recompute=recompute, listener=listener, log_level=log_level)
    return open_run(summary.folder)


def bundle(run: RunResult | str | Path, path: str | Path | None = None, *, bitstreams: bool = False) -> Path:
    """Put a run, or the run in a folder, into one file and return its path, by default `FOLDER.bundle.zip`.

    bitstreams: include the bitstreams of the codecs. Raises StoreError for a folder that is no run, has no results, is
    being written to or is damaged.
    """
    folder = run.folder if isinstance(run, RunResult) else Path(run)
    return write_bundle(folder, None if path is None else Path(path), bitstreams=bitstreams).path


def open_bundle(path: str | Path, out: str | Path | None = None) -> Run:
    """Unpack a bundle into the folder `out`, by default beside it, and return its results.

    No code of the bundle is run. Raises StoreError for a bundle that is refused, and if the folder exists.
    """
    folder = folder_beside(Path(path)) if out is None else Path(out)
    unpack_bundle(Path(path), folder)
    return open_run(folder)


def _matches(codec: PluginSetting, setting: str | Mapping[str, Any]) -> bool:
    """Return whether a codec's setting has this label, or these parameters among its own."""
    if isinstance(setting, str):
        return setting in ("", codec.label)
    return all(name in codec.params and codec.params[name] == value for name, value in setting.items())
