"""``python -m solver_backend VERB``, and the console script ``manifold``."""

import gc
import os
import sys

from solver_backend.exchange.early_signals import end_by_signals

if __name__ in ("__main__", "solver_backend.__main__"):  # not in the children of a pool
    end_by_signals()

# NumPy's products here are many and small: threads inside each one wait for one another as soon as another program
# wants the processor. This must be set before NumPy is loaded. Settings of the user take precedence.
for _setting in ("OPENBLAS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
    os.environ.setdefault(_setting, "1")

# Importing and solving make objects by the hundred thousand that stay, and next to no rings: a look for rings after
# every 700 new ones, as Python has it, costs a solve 0.1 s.
gc.set_threshold(20_000)

# Wheels of the extension come after what Blender's Python has itself.
if _packages := os.environ.get("MANIFOLD_MOCAP_PACKAGES"):
    sys.path.append(_packages)

from solver_backend.cli.main import main  # noqa: E402

if __name__ == "__main__":
    sys.exit(main())
