"""Generate docs/reference/python-api.md with the public names of ``solver_backend``.

The site adds their docstrings.
"""

from __future__ import annotations

import solver_backend

_HEAD = """<!-- Made by python3 dev.py docs from solver_backend.__all__; edit that. -->

# Python API

These are the public names of the `solver_backend` package. Import it with `.venv/bin/python` in a clone, or run
`pip install .` there to use another Python. `help(NAME)` prints the documentation of a name. The folder
`docs/examples` of the repository contains example scripts, such as
[`bake_headless`](../examples/bake_headless.py), which bakes a motion without Blender's window.

The public names follow [Semantic Versioning](https://semver.org/spec/v2.0.0.html). Before version 1.0.0, a minor
version may change them. All other names may change in any version.

```python
from solver_backend import SolveSettings, load_capture, solve, write_motion

solution = solve(load_capture("trial"), SolveSettings(smoothing=2.0))  # also prior=, person=, start= and results=
print(solution.motion.joint_sigma)  # (F, J) standard deviation of each joint in metres
write_motion("motion.npz", solution.motion)
```

You can make a capture from your own arrays. Lengths are in metres, and Z is up:

```python
from solver_backend import Cameras, Capture, JointSet, Keypoints2D, solve

cameras = Cameras(names=names, K=K, distortion=distortion, R=R, t=t, image_size=sizes)  # x_camera = R x + t
keypoints = Keypoints2D(xy=xy, confidence=confidence, joint_set=JointSet("BODY_25"), fps=60.0)  # (C, F, K, 2) px
solution = solve(Capture(name="take", cameras=cameras, keypoints=keypoints))
```

For markers, use `Capture(name="take", markers=MarkerCloud(positions=points, fps=100.0, labels=names))`.
"""


def python_api_page() -> str:
    """Return the reference page of the Python API."""
    objects = [getattr(solver_backend, name) for name in solver_backend.__all__]
    paths = sorted(f"{found.__module__}.{found.__qualname__}" for found in objects)
    return "\n".join([_HEAD, *(f"::: {path}\n" for path in paths)])
