"""The verbs of markers, one after the other: layout, edited by hand, calibrate, solve with the subject."""

from __future__ import annotations

import json

import numpy as np

from solver_backend.body.markers import marker_layout
from solver_backend.cli.main import main
from solver_backend.io.markers.c3d_writer import write_c3d
from solver_backend.io.native.motion_file import read_motion
from solver_backend.io.native.subject_file import read_subject
from solver_backend.types import MarkerCloud
from tests.support.worn_markers import worn_markers

LABELS = marker_layout("PLUGIN_GAIT_39")


def test_layout_calibrate_solve(tmp_path, capsys):
    worn = worn_markers(LABELS, 12, step=5)
    points = np.concatenate([worn.cloud.positions, worn.cloud.positions[:, :2] + 0.02], axis=1)
    take = write_c3d(tmp_path / "walk.c3d", MarkerCloud(points, 60.0, (*LABELS, "hat", "band")))
    layout, subject, out = (tmp_path / name for name in ("mine.json", "anna.npz", "walk.npz"))

    assert main(["layout", str(take), "--out", str(layout)]) == 0
    values = json.loads(layout.read_text(encoding="utf-8"))
    assert values["places"]["hat"] is None and values["places"]["LKNE"] == "LKNE"
    values["places"] |= {"hat": "", "band": "@head"}
    layout.write_text(json.dumps(values), encoding="utf-8")

    argv = ["calibrate", str(take), "--out", str(subject), "--layout", str(layout)]
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
