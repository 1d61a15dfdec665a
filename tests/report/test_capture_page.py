"""The page of a capture before it is solved: what is drawn, which views agree, what was corrected."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.cli.main import main
from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.exchange.errors import OutputExists
from solver_backend.io.native.capture_file import write_capture
from solver_backend.report.capture_page import capture_html, write_capture_report
from solver_backend.report.plots import space_drawing
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Capture, MarkerCloud
from tests.support.html_page import Strict

DEMO = demo_capture(num_frames=60)
CAMERAS, KEYPOINTS = DEMO.require_multiview()


def words(page: str) -> str:
    return "".join(Strict(page).words)


def agreement(page: str, camera: str) -> float:
    """Return the share that the table states of a camera, in percent."""
    found = re.search(rf"<th>{camera}</th><td[^>]*>([0-9.]+)</td>", page)
    assert found is not None
    return float(found[1])


def test_cameras_person_and_views_are_on_the_page() -> None:
    found = diagnostic("scene_message", text="The lens is <odd>.")
    page = capture_html(replace(DEMO, problems=(found,), notes=(diagnostic("scene_message", text="A note."),)))
    text = words(page)
    for word in ("Capture demo", "Space", "Views", "Detections that agree", "cam03", "The lens is <odd>.", "A note."):
        assert word in text
    assert "<odd>" not in page and page.count('class="view"') == 8
    assert page.count('class="bone a"') == page.count('class="bone b"') + 6 > 20
    assert min(agreement(page, name) for name in CAMERAS.names) > 80


def test_a_view_that_contradicts_stands_out() -> None:
    xy = KEYPOINTS.xy.copy()
    xy[2] += [90, 0]
    page = capture_html(replace(DEMO, keypoints=replace(KEYPOINTS, xy=xy)))
    assert agreement(page, "cam03") < 40 < 60 < agreement(page, "cam01")


def test_markers_are_drawn_without_views() -> None:
    points = np.random.default_rng(0).uniform(0, 2, (30, 12, 3))
    points[:, 3] = np.nan
    labels = tuple(f"M{i}" for i in range(12))
    capture = Capture(name="take", markers=MarkerCloud(points, 100.0, labels))
    page = capture_html(capture)
    assert "Views" not in words(page) and page.count('class="point"') == 33


def test_nobody_is_drawn_as_nobody() -> None:
    empty = replace(KEYPOINTS, confidence=np.zeros_like(KEYPOINTS.confidence))
    page = capture_html(replace(DEMO, keypoints=empty))
    assert "bone" not in page.split("</style>")[1] and page.count('class="view"') >= 4
    assert space_drawing(None, np.full((3, 5, 3), np.nan), None) == ""


def test_one_camera_has_a_page() -> None:
    one = DEMO.views([0])
    assert "Keypoints that each camera detected" in words(capture_html(one))


def test_the_verb_writes_the_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    take, page = tmp_path / "take.npz", tmp_path / "page.html"
    write_capture(take, DEMO)
    assert main(["info", str(take), "--report", str(page)]) == 0
    assert str(page) in capsys.readouterr().out and "Capture demo" in page.read_text(encoding="utf-8")
    assert main(["info", str(take), "--report", str(page)]) == 3
    with pytest.raises(OutputExists):
        write_capture_report(page, DEMO)
