"""Codec settings as benchmark cases: the codec, a photograph, and the facts recorded beside the times."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
import pytest
import skimage.data
from pydantic import ValidationError

from codecbench.core.conformance.settings import setting_from_text, setting_label
from codecbench.core.contracts.codec import Codec
from codecbench.core.contracts.errors import CodecbenchError, Unsupported
from codecbench.core.contracts.image import Image, Layout, gray_from_image
from codecbench.core.counting.trace import CountingTrace
from codecbench.core.engine.plugins.registry import installed, loads
from codecbench.plugins.evaluators.fidelity import psnr_db
from codecbench.pytesting import ALL


@dataclass(frozen=True)
class CodecCase:
    """A codec setting, and the image of its benchmark."""

    name: str
    codec: Codec[Any]
    image: Image

    @cached_property
    def prepared(self) -> Codec[Any]:
        """The codec after its search on this image."""
        return self.codec.prepared(self.image)

    def facts(self) -> dict[str, Any]:
        """Return what is recorded beside the times: version, size, PSNR, and operation counts if the codec has them."""
        bitstream = self.prepared.encode(self.image)
        facts: dict[str, Any] = {
            "codec": self.name,
            "version": self.codec.version,
            "size_bytes": len(bitstream),
            "psnr_db": psnr_db(self.image, self.codec.decode(bitstream)),
        }
        if self.codec.capabilities.counts_operations:
            for direction, work in (("encode", lambda trace: self.prepared.encode(self.image, trace=trace)),
                                    ("decode", lambda trace: self.codec.decode(bitstream, trace=trace))):  # fmt: skip
                trace = CountingTrace()
                work(trace)
                facts[f"{direction}_operations"] = int(sum(counts.total for counts in trace.counts.values()))
        return facts


def codec_cases(text: str) -> list[CodecCase]:
    """Return the cases of one `--codecbench` value. Raises pytest.UsageError if it cannot be understood."""
    registry = installed()
    name, _, rest = text.strip().partition(" ")
    cases = []
    for plugin in registry.plugins("codec") if name == ALL else [None]:
        if plugin is not None and plugin.missing is not None:
            continue
        chosen = plugin.spec.name if plugin is not None else name
        try:
            registry.ask(loads, "codec", chosen, of=[("codec", chosen)])  # a crash ends another process
            cls = registry.load("codec", chosen)
            if not cls.stateless:
                raise Unsupported(f"{chosen} codes sequences; these benchmarks are for single images")
            for example in [setting_from_text(rest)] if rest else cls.examples:
                codec = cls(cls.params_type.model_validate(example))
                cases.append(CodecCase(setting_label(chosen, example), codec, _photograph(cls)))
        except Unsupported as error:
            if plugin is None:
                raise pytest.UsageError(f"--codecbench {text}: {error}") from None
        except (CodecbenchError, ValidationError) as error:
            if plugin is not None and plugin.hosted:
                warnings.warn(pytest.PytestWarning(f"--codecbench leaves out {error}"), stacklevel=1)
                continue
            raise pytest.UsageError(f"--codecbench {text}: {error}") from None
    return cases


def _photograph(cls: type[Codec[Any]]) -> Image:
    """Return a 640x480 photograph, in color if the codec accepts color; if it accepts 16 bits only, as if of depth."""
    photograph = skimage.data.astronaut()  # type: ignore[no-untyped-call]
    image = np.asarray(cv2.resize(photograph, (640, 640), interpolation=cv2.INTER_CUBIC), np.uint8)[80:560]
    image = np.ascontiguousarray(image)
    layouts = cls.capabilities.layouts
    if Layout(3) in layouts:
        return image
    gray: Image = gray_from_image(image)
    return gray if Layout(1) in layouts else 500 + 16 * gray.astype(np.uint16)
