"""Start the solver's command line: ``python -m solver_backend VERB``, or the script ``manifold``."""

import gc
import os
import sys

from solver_backend.exchange.early_signals import end_by_signals

if __name__ in ("__main__", "solver_backend.__main__"):  # not in the children of a pool
    end_by_signals()

# NumPy's products here are many and small. Threads inside each product wait for one another as soon as another program
# uses the processor. This must be set before NumPy is imported. Settings of the user take precedence.
for _setting in ("OPENBLAS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
    os.environ.setdefault(_setting, "1")

# Importing and solving create hundreds of thousands of permanent objects and few reference cycles. Python's default, a
# search for cycles after every 700 new objects, costs a solve 0.1 s.
gc.set_threshold(20_000)

# Wheels of the extension come after the packages in Blender's Python.
if _packages := os.environ.get("MANIFOLD_MOCAP_PACKAGES"):
    sys.path.append(_packages)

from solver_backend.cli.main import main  # noqa: E402

if __name__ == "__main__":
    sys.exit(main())
