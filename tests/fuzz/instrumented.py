"""``python -m tests.fuzz.instrumented READERS SECONDS [STATE]``: atheris on readers that are instrumented as they are
imported, which is why nothing of them may have been imported before. ``python -m tests.fuzz --bytes`` starts it.
"""

from __future__ import annotations

import os
import sys
from contextlib import redirect_stderr
from pathlib import Path

import atheris

_INSTRUMENTED = ["solver_backend.io", "solver_backend.exchange", "solver_backend.body.files"]

if __name__ == "__main__":
    instrumenting = atheris.instrument_imports(include=_INSTRUMENTED)
    with open(os.devnull, "w") as nowhere, redirect_stderr(nowhere), instrumenting:  # a line for each module
        from tests.fuzz.byte_fuzzing import fuzz_bytes
        from tests.fuzz.targets import chosen
    only, seconds, *state = sys.argv[1:]
    sys.exit(fuzz_bytes(chosen(only), float(seconds), Path(state[0]) if state else None))
