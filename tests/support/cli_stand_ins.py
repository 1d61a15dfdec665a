"""Quick stand-ins for reading and solving, so that the command line is tested without either."""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from types import ModuleType
from typing import Any

from solver_backend.fitters.problem import Solution
from solver_backend.types import SMPL_JOINTS, Motion
from tests.support.scenes import small_capture, small_motion

FRAMES = 7


def with_legs(motion: Motion) -> Motion:
    """Return a motion of somebody whose legs are a person's in length."""
    joints = motion.joints.copy()
    for upper, lower in (("left_hip", "left_knee"), ("left_knee", "left_ankle")):
        joints[:, SMPL_JOINTS.index(lower)] = joints[:, SMPL_JOINTS.index(upper)] - [0.0, 0.0, 0.43]
    return replace(motion, joints=joints)


class StandIns:
    """What the verbs were asked to do, and what happens when they are."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, dict[str, Any]]] = []
        self.load_error: Exception | None = None
        self.solve_error: Exception | None = None
        self.solve_s = 0.0

    def load_capture(self, path, **options):
        self.calls.append(("load", {"path": path, **options}))
        if self.load_error is not None:
            raise self.load_error
        return small_capture(FRAMES)

    def solve(self, capture, settings, progress, *, person=None, start=None, results=(), others=(), each=None):
        self.calls.append(("solve", {"capture": capture.name, "settings": settings}))
        sys.stdout.write("a library that prints\n")
        progress("Solving", 0, 2)
        end = time.monotonic() + self.solve_s
        while time.monotonic() < end:
            progress("Solving", 1, 2)
            time.sleep(0.01)
        if self.solve_error is not None:
            raise self.solve_error
        progress("Solving", 2, 2)
        return Solution(with_legs(small_motion(FRAMES)), "Converged.")

    def resolve_range(self, capture, motion, stretch, settings, progress):
        self.calls.append(("resolve", {"capture": capture.name, "stretch": stretch}))
        return Solution(motion, "Converged.")

    def report_html(self, capture, motion, fit=None):
        self.calls.append(("report", {"capture": capture, "motion": motion}))
        return "<html>a page</html>"

    def modules(self) -> dict[str, ModuleType]:
        """Return modules to put in place of the real ones."""
        found = {}
        for name, functions in (
            ("solver_backend.io.load", (self.load_capture,)),
            ("solver_backend.fitters.pipeline", (self.solve, self.resolve_range)),
            ("solver_backend.report.page", (self.report_html,)),
        ):
            found[name] = ModuleType(name)
            for function in functions:
                setattr(found[name], function.__name__, function)
        return found


if __name__ == "__main__":  # a slow solver in a process of its own, for signals
    from solver_backend.cli.main import main

    slow = StandIns()
    slow.solve_s = 60.0
    sys.modules.update(slow.modules())
    sys.exit(main(sys.argv[1:]))
