"""The page docs/reference/python-api.md: the public names of ``solver_backend``; the site adds their docstrings."""

from __future__ import annotations

import solver_backend

_HEAD = """<!-- Made by python3 dev.py docs from solver_backend.__all__; edit that. -->

# Python API

These are the names of `import solver_backend`, with their docstrings on the site. Examples are in `docs/examples`.

```python
from solver_backend import load_capture, solve, write_motion

solution = solve(load_capture("trial"))
write_motion("motion.npz", solution.motion)
```
"""


def python_api_page() -> str:
    """Return the page that names everything public."""
    objects = [getattr(solver_backend, name) for name in solver_backend.__all__]
    paths = sorted(f"{found.__module__}.{found.__qualname__}" for found in objects)
    return "\n".join([_HEAD, *(f"::: {path}\n" for path in paths)])
