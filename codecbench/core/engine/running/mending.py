"""A run folder in which no cell is left to compute, and yet a file is damaged that only a worker can write."""

from __future__ import annotations

import logging
from typing import Any, Final

from codecbench.core.contracts.executor import Executor, Task
from codecbench.core.engine.running.work import prepare_worker, tell_environment
from codecbench.core.engine.storage.store import Store

log = logging.getLogger("codecbench.run")

_POLL_S: Final = 0.2


def mend_environments(store: Store, executor: Executor[Any], timeout_s: float) -> None:
    """Have a worker tell its environment again where the file of one is damaged that no cell's worker will write."""
    damaged = store.environments.damaged()
    if not damaged:
        return
    executor.start(1, prepare_worker)
    executor.submit(Task("environment", tell_environment, None, timeout_s))
    while (finished := executor.next_finished(_POLL_S)) is None or finished.task_id != "environment":
        pass
    if finished.value is not None:
        name, description = finished.value
        store.environments.write(name, description)
    for name, reason in damaged.items():
        mended = finished.value is not None and finished.value[0] == name
        outcome = "it was written again" if mended else "no worker of this run can tell it again"
        log.warning("environment/%s.json is damaged (%s); %s", name, reason, outcome)
