"""Code a picture by the profile `context` and write what came of it; kernels compiled as the argument says.

coded_elsewhere.py fastmath|exact
"""

from __future__ import annotations

import hashlib
import sys

import numba


def digests() -> str:
    """Of the bitstream, and of what it decodes to."""
    from multilevel_pictures import textured

    from codecbench.plugins.codecs.multilevel import Multilevel

    codec = Multilevel.create(profile="context", qf=0.8, restart=2, lapped=True)
    stream = codec.encode(textured(96, 120))
    pixels = codec.decode(stream)
    return f"{hashlib.sha256(stream).hexdigest()} {hashlib.sha256(pixels.tobytes()).hexdigest()}"


def _compile_with_fastmath() -> None:
    plain = numba.njit
    numba.njit = lambda *args, **options: plain(*args, **{**options, "fastmath": True})


if __name__ == "__main__":
    if sys.argv[1] == "fastmath":
        _compile_with_fastmath()
    sys.stdout.write(digests())
