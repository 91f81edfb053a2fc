"""Frames beside what was decoded of them, read again from a run folder."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from codecbench.core.contracts.errors import DatasetError, ParamsError
from codecbench.core.contracts.evaluator import CodedSequence
from codecbench.core.engine.planning.model import PluginSetting
from codecbench.core.engine.registry import installed
from codecbench.core.engine.running.coding.coded_frames import CodedFrames
from codecbench.core.engine.running.coding.position import WorkPosition
from codecbench.core.engine.storage.bitstream_file import BitstreamFile
from codecbench.core.engine.storage.plan_file import PlanFile
from codecbench.core.engine.storage.store import Store
from codecbench.core.results.run_result import RunResult


def stored_frames(
    run: RunResult, codec: str, setting: str | Mapping[str, Any] = "", sequence: str | None = None
) -> CodedSequence:
    """See `RunResult.frames`."""
    jobs = [job for job in run.plan.jobs if sequence in (None, job.sequence.name)]
    found = [job for job in jobs if job.codec.name == codec and _is(job.codec, setting)]
    if len({job.codec for job in found}) != 1:
        there = ", ".join(dict.fromkeys(f"{job.codec.name} {job.codec.label}".strip() for job in found or jobs))
        wanted = setting if isinstance(setting, str) else ", ".join(f"{key}={value}" for key, value in setting.items())
        raise ParamsError(f"{codec} {wanted} is not one setting of the run; say which of {there}".replace("  ", " "))
    elsewhere = PlanFile(run.folder).origin_elsewhere()
    if elsewhere is not None:
        raise DatasetError(f"the run was made in {elsewhere}, so the sequences that its plan names are not opened")
    job, registry = found[0], installed()
    opened = registry.create("dataset", job.sequence.dataset.name, job.sequence.dataset.params).open()
    if opened.fingerprint != job.sequence.fingerprint:
        raise DatasetError(f"{job.sequence.name}: its frames are no longer those of the run")
    coder = registry.create("codec", job.codec.name, job.codec.params)
    bitstreams = BitstreamFile(Store(run.folder).coded_path(job.id), job.id)
    return CodedFrames(opened, coder, bitstreams, WorkPosition())


def _is(codec: PluginSetting, setting: str | Mapping[str, Any]) -> bool:
    """Whether a codec's setting has this label, or these among its parameters."""
    if isinstance(setting, str):
        return setting in ("", codec.label)
    return all(name in codec.params and codec.params[name] == value for name, value in setting.items())
