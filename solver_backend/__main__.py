"""``python -m solver_backend``: solve, info, convert, demo-capture, evaluate."""

import sys

from solver_backend.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
