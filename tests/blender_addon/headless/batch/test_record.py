"""A take's record is read whole or not at all: what the summary shows and the next run needs is there, of its kind."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from blender_addon.headless.batch.record import NAME, read_record

_STEP: dict[str, Any] = {"key": "ab12", "outputs": ["a.npz"], "notes": [], "seconds": 1.5}
_RECORD: dict[str, Any] = {
    "take": "a", "capture": "a.npz", "status": "done", "steps": {"solve": _STEP}, "attempts": [{"step": "solve"}],
    "solve": {"frames": 3, "reprojection_median_px": 2.5, "unsure_frames": 0, "unseen_frames": 0},
}  # fmt: skip
_ERROR = {"code": "take_failed", "message": "no", "exit_code": 4}


def _read(folder: Path, **changes: Any) -> object:
    (folder / NAME).write_text(json.dumps(_RECORD | changes))
    return read_record(folder)


def test_a_record_is_read(tmp_path: Path) -> None:
    assert _read(tmp_path) == _RECORD
    assert _read(tmp_path, status="failed", error=_ERROR) is not None


@pytest.mark.parametrize(
    "changes",
    [
        *({"steps": {"solve": {key: value for key, value in _STEP.items() if key != left}}} for left in _STEP),
        {"steps": {"solve": _STEP | {"seconds": "long"}}},
        *({"error": {key: value for key, value in _ERROR.items() if key != left}} for left in _ERROR),
        {"solve": {"frames": "many"}}, {"solve": {"marker_median_mm": float("nan")}}, {"solve": {"frames": 10**400}},
        {"outputs": [1]}, {"seconds": {}},
    ],
)  # fmt: skip
def test_a_record_that_lacks_something_is_none(changes: dict[str, Any], tmp_path: Path) -> None:
    assert _read(tmp_path, **changes) is None
