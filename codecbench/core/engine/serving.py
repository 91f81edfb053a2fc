"""What a host process does: call functions of codecbench on the plugins of its company, and answer with data.

It imports as little as it can, because `codecbench list` waits for it.
"""

from __future__ import annotations

import importlib
import json
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from importlib.abc import MetaPathFinder
from importlib.metadata import EntryPoint
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
    tempfile.tempdir = folder  # also when a plugin has removed it: otherwise the system's would be the next
    with os.fdopen(requests, "rb") as stream:
        for line in stream:
            request = json.loads(line)
            signal.alarm(request["limit_s"] + _MARGIN_S)
            content = _answer(partial(_called, request, company), request["number"])
            signal.alarm(0)
            _write(answers, content)
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(0)


_SHARED: Final = {"pydantic": "codecbench.core.contracts.params", "numpy": "numpy", "cv2": "cv2"}
"""Packages that take long to import and that many plugins use, and what is imported of them for all children."""
_THREADS: Final = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")
"""Variables that keep these libraries from starting threads, beside which forking would not be safe."""


def scouted(_: Registry, companies: list[str], limit_s: float) -> dict[str, Any]:
    """What each of these distributions offers, or `error` and `text`; see `answers_of_children`.

    Those that turn out to import a shared package are asked a second time, when this process has imported it.
    """
    points = points_by_origin()

    def asked(origins: Sequence[str], question: Callable[[Sequence[EntryPoint]], Any]) -> dict[str, Any]:
        questions: dict[str, Callable[[], bytes]] = {
            origin: partial(_answer, partial(question, points[origin])) for origin in origins
        }
        return answers_of_children(questions, limit_s)

    answers = asked(companies, _offered_unless_shared)
    if again := [origin for origin, answer in answers.items() if answer.get("value") == _AGAIN]:
        _import_shared()
        answers |= asked(again, _offered)
    return answers


def scouted_line(companies: list[str], limit_s: float) -> bytes:
    """`scouted` as a line of JSON: `value`, or `error` and `text`."""
    return _answer(lambda: scouted(Registry(()), companies, limit_s))


_AGAIN: Final = "again"


def _offered(points: Sequence[EntryPoint]) -> Any:
    return offered(Registry(points))


def _offered_unless_shared(points: Sequence[EntryPoint]) -> Any:
    """What is offered, or `_AGAIN` as soon as a shared package is to be imported."""
    watch = _Watch()
    sys.meta_path.insert(0, watch)
    try:
        value = _offered(points)
    except _SharedImport:
        value = _AGAIN
    return _AGAIN if watch.has_met_one else value


class _SharedImport(BaseException):
    """A shared package is about to be imported; no ImportError, which plugins catch where a package is optional."""


class _Watch(MetaPathFinder):
    has_met_one = False

    def find_spec(self, fullname: str, path: object = None, target: object = None) -> None:
        if fullname in _SHARED:
            self.has_met_one = True
            raise _SharedImport(fullname)


def _import_shared() -> None:
    before = dict(os.environ)
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    for name in _SHARED.values():
        importlib.import_module(name)
    os.environ.clear()
    os.environ.update(before)


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
