"""The verbs of markers, one after the other: layout, edited by hand, calibrate, solve with the subject."""

from __future__ import annotations

import json

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.markers import marker_layout
from solver_backend.cli.main import main
from solver_backend.io.markers.c3d import write_c3d
from solver_backend.io.native.motion_file import read_motion, read_subject
from solver_backend.io.png import read_png
from solver_backend.types import MarkerCloud
from tests.support.worn_markers import worn_markers

LABELS = marker_layout("PLUGIN_GAIT_39")


def test_layout_calibrate_solve(tmp_path, capsys):
    worn = worn_markers(LABELS, 12, step=5)
    points = np.concatenate([worn.cloud.positions, worn.cloud.positions[:, :2] + 0.02], axis=1)
    take = write_c3d(tmp_path / "walk.c3d", MarkerCloud(points, 60.0, (*LABELS, "hat", "band")))
    layout, subject, out = (tmp_path / name for name in ("mine.json", "anna.npz", "walk.npz"))

    assert main(["markers layout", str(take), "--out", str(layout)]) == 0
    values = json.loads(layout.read_text(encoding="utf-8"))
    assert values["places"]["hat"] is None and values["places"]["LKNE"] == "LKNE"
    values["places"] |= {"hat": "", "band": "@head"}
    layout.write_text(json.dumps(values), encoding="utf-8")

    argv = ["markers calibrate", str(take), "--out", str(subject), "--layout", str(layout)]
    assert main([*argv, "--json"]) == 0
    result = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert result["markers"]["band"]["place"] == "@head" and "hat" not in result["markers"]
    assert read_subject(subject).labels == (*LABELS, "band")
    assert main(argv) != 0  # it is there already

    solve = ["solve", str(take), "--out", str(out), "--method", "frame"]
    assert main([*solve, "--subject", str(subject)]) == 0
    motion = read_motion(out)
    assert motion.marker_labels == (*LABELS, "band") and motion.layout is not None and motion.layout[-1] == "@head"
    assert motion.marker_flags is not None and motion.cleaned_markers is not None and motion.offsets is not None
    assert np.nanmedian(motion.marker_residual_mm) < 10.0

    assert main([*solve[:2], "--out", str(tmp_path / "b.npz"), "--subject", str(layout)]) != 0
    assert not (tmp_path / "b.npz").exists()


@pytest.mark.slow
def test_the_places_of_a_layout_are_drawn(tmp_path, capsys):
    pictures = {}
    for layout, count in (("MANIFOLD_53", 53), ("HELEN_HAYES", 25)):
        out = tmp_path / f"{layout}.png"
        assert main(["markers places", "--layout", layout, "--out", str(out), "--json"]) == 0
        said = json.loads(capsys.readouterr().out.splitlines()[-1])
        pictures[layout] = read_png(out)
        height, width, _ = pictures[layout].shape
        assert said["markers"] == count and said["size"] == [width, height]
    assert main(["markers places", "--out", str(tmp_path / "MANIFOLD_53.png")]) != 0  # it is there already
    facing = (pictures["MANIFOLD_53"] == (255, 120, 20)).all(-1)
    behind = (pictures["MANIFOLD_53"] == (200, 145, 85)).all(-1)
    # Discs of 5 pixels' radius within a rim of one: each marker faces one side, and is behind on the other one.
    assert 0.5 * 53 * np.pi * 4.0**2 < facing.sum() < 53 * np.pi * 5.0**2
    assert behind.sum() < facing.sum()  # some lie behind those that face
    assert facing[:, : facing.shape[1] // 2].any() and facing[:, facing.shape[1] // 2 :].any()
    for arguments, code in ((["--layout", "NOBODY"], "command_line_invalid"), (["--body", "nobody"], "body_unknown")):
        assert main(["markers places", *arguments, "--out", str(tmp_path / "x.png"), "--json"]) != 0
        assert json.loads(capsys.readouterr().out.splitlines()[-1])["code"] == code
    assert not (tmp_path / "x.png").exists()


@pytest.mark.slow
def test_names_do_not_stand_on_one_another():
    from solver_backend.synthesis.studio import places_picture as drawn

    stood: list[np.ndarray] = []
    kept, drawn._stood = drawn._stood, lambda *a: stood.append(np.stack(boxes := kept(*a))) or boxes
    try:
        drawn.places_picture(load_body(), marker_layout("MANIFOLD_53"))
    finally:
        drawn._stood = kept
    assert sum(map(len, stood)) == 53
    for boxes in stood:
        shared = drawn._overlap(boxes[:, None], boxes) * ~np.eye(len(boxes), dtype=bool)
        assert shared.max() < 3.0
