"""What a host process does: call functions of codecbench on the plugins of its company, and answer with data.

It imports as little as it can, because `codecbench list` waits for it.
"""

from __future__ import annotations

import importlib
import json
import os
import shutil
import signal
from collections.abc import Callable
from functools import partial
from typing import Any, Final

from codecbench.core.contracts import errors
from codecbench.core.engine.entry_points import points_by_origin
from codecbench.core.engine.foreign_errors import describe_error
from codecbench.core.engine.registry import Registry, offered, registry_of
from codecbench.core.engine.scouting import answers_of_children

_MARGIN_S: Final = 5
"""A host whose asker is gone, so that nobody ends it, ends itself so long after its time."""


def serve(requests: int, answers: int, company: list[str], folder: str) -> None:
    """Answer one request a line until there are no more, and remove `folder`, whose asker may be gone.

    requests, answers: descriptors of pipes. A request names a function, its arguments and how long it may take.
    folder: where this process keeps its temporary files.
    """
    with os.fdopen(requests, "rb") as stream:
        for line in stream:
            request = json.loads(line)
            signal.alarm(request["limit_s"] + _MARGIN_S)
            content = _answer(partial(_called, request, company), request["number"])
            signal.alarm(0)
            _write(answers, content)
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(0)


_SHARED: Final = "codecbench.core.contracts.params"
"""What every child would import for itself, the largest part of it that starts no thread."""


def scouted(_: Registry, companies: list[str], limit_s: float) -> dict[str, Any]:
    """What each of these distributions offers, or `error` and `text`; see `answers_of_children`."""
    importlib.import_module(_SHARED)
    points = points_by_origin()

    def question(origin: str) -> bytes:
        return _answer(lambda: offered(Registry(points[origin])))

    return answers_of_children({origin: partial(question, origin) for origin in companies}, limit_s)


def _called(request: dict[str, Any], company: list[str]) -> Any:
    module, _, name = request["function"].partition(":")
    function = getattr(importlib.import_module(module), name)
    return function(registry_of(tuple(company), ours=request["ours"]), *request["arguments"])


def _answer(call: Callable[[], Any], number: int = 0) -> bytes:
    """The value or what went wrong, as a line of JSON. number: of the request."""
    process = os.getpid()
    try:
        return _line({"number": number, "value": call()})
    except BaseException as error:  # noqa: BLE001 - whatever a stranger's code does becomes the answer
        known = next((kind.__name__ for kind in type(error).__mro__ if kind.__module__ == errors.__name__), "")
        text = str(error) if known else describe_error(error)
        return _line({"number": number, "error": known, "text": text[:4000]})
    finally:
        if os.getpid() != process:
            os._exit(0)  # the call came back twice, and one answer is enough


def _line(answer: dict[str, Any]) -> bytes:
    return json.dumps(answer).encode() + b"\n"


def _write(descriptor: int, content: bytes) -> None:
    while content:
        content = content[os.write(descriptor, content) :]
