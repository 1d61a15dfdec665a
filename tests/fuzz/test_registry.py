"""Every function that opens files of somebody else is reached by a target of the fuzzer."""

from __future__ import annotations

import pytest

from tests.fuzz.registry import opening_functions, reached_functions, registered_functions
from tests.fuzz.targets import TARGETS, chosen

OURS = {
    "_add_finger_joints", "_fingers", "_hands_file", "_part", "_record", "_score", "add_catalog", "digest_of", "german",
    "export_vrma", "has_fingers", "items_of", "load_table", "page_html", "read_face_table", "read_verbs", "resident_mb",
    "run_studio",
    "thumbnail", "write_videos",
}  # fmt: skip
"""Functions that read files which this program ships with or wrote a moment ago, and /proc."""
BY_VERBS = {
    "_markers",
    "_settings",
    "detect",
    "moved_files",
    "require_safe",
    "_sources",
    "is_report",
    "__init__",
    "_of_pictures",
    "_is_litert",
    "_litert",
    "chosen_network",
}
"""Functions that only verbs call, which have targets of their own, that look at a file's name and first bytes, or that
hand a model to its runtime."""


@pytest.mark.slow
def test_every_function_that_opens_a_file_is_reached() -> None:
    reached = reached_functions(chosen("readers"))
    missed = {place for place in opening_functions() | registered_functions() if place not in reached}
    left = sorted(place for place in missed if place[1] not in OURS | BY_VERBS)
    assert not left, "these readers need a target in tests/fuzz: " + ", ".join(map(" ".join, left))


def test_the_readers_of_markers_are_reached_and_a_new_one_would_be_missed() -> None:
    own = {place for place in registered_functions() if place[0].startswith("solver_backend/io/markers/")}
    reached = reached_functions(target for target in TARGETS if target.name.startswith("markers"))
    assert len(own) > 8 and not own - reached
    assert ("solver_backend/io/markers/mat_file.py", "read_mat") in opening_functions()
    without = reached_functions(target for target in TARGETS if target.name == "markers, TRC")
    assert ("solver_backend/io/markers/camera_systems.py", "read_qualisys_mat") not in without
