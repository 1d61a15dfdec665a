"""The page of a batch: worst first, pictures of what was solved, nothing that could run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from blender_addon.headless.batch.summary import stick_figures, summary_page, thumbnail, worst_first
from solver_backend.io.native.motion_file import write_motion
from tests.support.scenes import small_motion


def take(name: str, status: str = "done", **more: Any) -> dict[str, Any]:
    return {"take": name, "status": status, "outputs": [f"{name}/{name}.npz"], **more}


def test_the_worst_come_first_with_their_pictures(tmp_path: Path) -> None:
    for name in ("good", "far"):
        (tmp_path / name).mkdir()
        write_motion(tmp_path / name / f"{name}.npz", small_motion())
    (tmp_path / "far" / "far_contact.png").write_bytes(b"png")
    (tmp_path / "good" / "good.html").write_text("page")
    far = take("far", solve={"reprojection_median_px": 9.0, "frames": 4})
    far["outputs"].append("far/far_contact.png")
    takes = [
        take("good", solve={"reprojection_median_px": 1.0, "frames": 4}),
        far,
        {"take": "<b>\u202eevil", "status": "set aside", "error": {"message": "<script>alert(1)</script>"}},
    ]
    page = summary_page(worst_first(takes), tmp_path, "2 done in 1.0 min")
    assert page.index("evil") < page.index("far") < page.index("good.html")
    assert 'src="far/far_contact.png"' in page and page.count("<svg") == 1 and "<h1>3 takes" in page
    assert "<script" not in page and "\u202e" not in page and "default-src 'none'" in page
    assert "2 done, 1 set aside" in page


def test_the_dashboard_can_be_followed_and_nothing_else_becomes_a_link(tmp_path: Path) -> None:
    said = 'by 2 workers, dashboard http://127.0.0.1:8787/status "><script>'
    page = summary_page([take("a")], tmp_path, said)
    assert '<a href="http://127.0.0.1:8787/status">http://127.0.0.1:8787/status</a>' in page
    assert "<script" not in page


def test_pictures_of_motions_that_cannot_be_read_are_left_out(tmp_path: Path) -> None:
    assert thumbnail(tmp_path / "none.npz") == ""
    (tmp_path / "damaged.npz").write_bytes(b"PK")
    assert thumbnail(tmp_path / "damaged.npz") == ""


def test_figures_stand_on_one_ground_inside_the_picture() -> None:
    joints = np.random.default_rng(0).uniform((-0.3, -0.3, 0), (0.3, 0.3, 1.7), (5, 24, 3))
    text = stick_figures(joints + [3.0, 5.0, 1.0])
    path = text.split('d="')[1].split('"')[0][1:]
    numbers = np.array([pair.split() for pair in path.replace("L", "M").split("M")], dtype=float)
    assert numbers.shape == (5 * 23 * 2, 2)
    assert numbers.min() > -5 and numbers[:, 0].max() < 225 and numbers[:, 1].max() <= 71
