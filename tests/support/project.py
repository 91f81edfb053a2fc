"""Where things of the project lie, for tests in any folder."""

from __future__ import annotations

from pathlib import Path
from typing import Final

SUPPORT: Final = Path(__file__).parent
TESTS: Final = SUPPORT.parent
ROOT: Final = TESTS.parent
DOCS: Final = ROOT / "docs"
EXAMPLES: Final = ROOT / "examples"
GOLDEN: Final = TESTS / "golden"
THIRD_PARTY: Final = TESTS / "third_party"
