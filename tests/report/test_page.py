"""The page as a whole: self-contained, well-formed, escaped, complete with and without optional data."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.exchange.errors import MotionInvalid, OutputExists
from solver_backend.report.page import report_html, write_report
from solver_backend.types import Capture, MarkerCloud
from solver_backend.types.cameras import CameraFits
from tests.support.html_page import Strict
from tests.support.solved import FRAMES, NAME, bare, solved


def test_the_page_is_well_formed_and_names_what_it_shows():
    page = report_html(*solved(truth=True))
    parsed = Strict(page)
    assert [tag for tag, _ in parsed.seen].count("h2") == 8
    text = "".join(parsed.words)
    for words in (
        NAME, "Warnings and notes", "Against the truth", "Residual over time", "Missing data", "Cameras and keypoints",
        "Joint angles", "Scene", "Settings and provenance", "cam_a", "left shoulder",
    ):  # fmt: skip
        assert words in text


def test_nothing_is_loaded_from_elsewhere():
    page = report_html(*solved(truth=True))
    assert not re.search(r"https?:|//[a-z]|@import|url\(|<link|<img|<iframe|\ssrc=", page.replace("// One cursor", ""))


def test_what_files_say_cannot_break_the_page():
    capture, motion = solved()
    evil = "</script><script>alert(1)</script>\"'&<"
    names = tuple(f"{evil}{c}" for c in range(4))
    cameras = replace(capture.cameras, names=names)
    found = diagnostic("scene_message", text=evil)
    capture = replace(capture, name=evil, cameras=cameras, sources=(evil,), notes=(found,), problems=(found,))
    motion = replace(motion, body=evil, provenance={**motion.provenance, evil: evil, "settings": {evil: evil}})
    parsed = Strict(report_html(capture, motion))
    assert [tag for tag, _ in parsed.seen].count("script") == 1
    assert any(evil in word for word in parsed.words)


def test_plots_carry_their_values_for_the_pointer():
    parsed = Strict(report_html(*solved()))
    data = [json.loads(a["data-plot"]) for tag, a in parsed.seen if tag == "figure" and a.get("data-plot")]
    assert len(data) == 8
    assert all(item["frames"] == FRAMES and all(len(v) == FRAMES for _, v in item["lines"]) for item in data)


def test_a_capture_of_markers_has_a_page_too():
    _, motion = bare(*solved())
    markers = MarkerCloud(np.zeros((FRAMES, 3, 3)), 30.0)
    parsed = Strict(report_html(Capture("ms", markers=markers), motion))
    text = "".join(parsed.words)
    assert "Joint angles" in text
    assert "Cameras and keypoints" not in text
    assert "Missing data" not in text


def test_residuals_are_computed_where_the_motion_has_none():
    capture, motion = solved(faults=False)
    text = "".join(Strict(report_html(capture, replace(motion, reprojection_px=None, provenance={}))).words)
    assert "Median reprojection error" in text


def test_a_solve_of_another_capture_is_refused():
    capture, motion = solved()
    keypoints = capture.keypoints.frames(0, 50)
    with pytest.raises(MotionInvalid, match="The motion has 90 frames, but the capture has 50"):
        report_html(replace(capture, keypoints=keypoints), motion)
    with pytest.raises(MotionInvalid, match=r"have the shape \(4, 90, 17\), but the detections of the capture \(3, 90"):
        report_html(capture.views([0, 1, 2]), motion)


def test_one_frame_is_enough():
    capture, motion = solved(faults=False)
    one = replace(
        motion, global_orient=motion.global_orient[:1], body_pose=motion.body_pose[:1], transl=motion.transl[:1],
        joints=motion.joints[:1], keypoints3d=motion.keypoints3d[:1], keyframes=motion.keyframes[:1],
        flags=motion.flags[:1], reprojection_px=motion.reprojection_px[:, :1],
    )  # fmt: skip
    Strict(report_html(replace(capture, keypoints=capture.keypoints.frames(0, 1)), one))


def test_the_page_is_written_whole_and_never_over_another(tmp_path):
    path = tmp_path / "page.html"
    assert write_report(path, *solved()) == path
    assert NAME.replace("&", "&amp;").replace("<", "&lt;")[:9] in path.read_text(encoding="utf-8")
    assert [p.name for p in tmp_path.iterdir()] == ["page.html"]
    with pytest.raises(OutputExists, match="already exist"):
        write_report(path, *solved())
    write_report(path, *solved(faults=False), overwrite=True)


def test_the_page_of_a_long_take_stays_small():
    capture, motion = solved(faults=False)
    repeat = 120
    keypoints = replace(
        capture.keypoints,
        xy=np.tile(capture.keypoints.xy, (1, repeat, 1, 1)),
        confidence=np.tile(capture.keypoints.confidence, (1, repeat, 1)),
    )
    long = replace(
        motion, **{name: np.concatenate([getattr(motion, name)] * repeat) for name in
                   ("global_orient", "body_pose", "transl", "joints", "keypoints3d", "keyframes", "flags")},
        reprojection_px=np.concatenate([motion.reprojection_px] * repeat, axis=1),
    )  # fmt: skip
    page = report_html(replace(capture, keypoints=keypoints), long)
    assert len(page) < 1_500_000


def test_the_solvers_own_uncertainty_is_shown():
    capture, motion = solved()
    assert "Uncertainty" not in report_html(capture, motion)
    sure = replace(motion, joint_sigma=np.full((FRAMES, 24), 0.012))
    parsed = Strict(report_html(capture, sure))
    plot = next(json.loads(a["data-plot"]) for _, a in parsed.seen if "least certain joint" in str(a.get("data-plot")))
    assert {value for _, values in plot["lines"] for value in values} == {12.0}


def test_how_the_cameras_fit_is_shown_where_it_was_checked():
    capture, motion = solved()
    grid = np.full((4, 3, 3), 2.0)
    grid[1, 0, 2], grid[2, 1, 1] = 9.87, np.nan
    fit = CameraFits(
        "calibration warning: 2.0 px", grid, np.full(4, 2.0), np.full(4, 1.5), np.full((4, 6), 1.2), 1.74, 3.2,
        4.1, ("cam_b was moved <b>",),
    )  # fmt: skip
    parsed = Strict(report_html(capture, motion, fit))
    text = "".join(parsed.words)
    for words in (
        "Calibration",
        "9.9",
        "calibration warning",
        "1.74 m",
        "3.2° ± 4.1°",
        "cam_b was moved <b>",
        "top right",
    ):
        assert words in text, words
    plain = Strict(report_html(capture, motion))
    assert sum(tag == "h2" for tag, _ in parsed.seen) == 1 + sum(tag == "h2" for tag, _ in plain.seen)
    good = Strict(report_html(capture, motion, replace(fit, findings=())))
    assert "Nothing contradicts the calibration." in "".join(good.words)
