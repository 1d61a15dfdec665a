"""Data sets: the same file makes the same pixels, a run that was ended goes on, and other programs' files are right."""

from __future__ import annotations

import hashlib
import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from solver_backend.cli.main import main
from solver_backend.io.load import load_capture, load_motion
from solver_backend.io.native.capture_file import read_capture
from solver_backend.io.png import read_png
from solver_backend.synthesis.studio.benchmark.page import page_html, table
from solver_backend.synthesis.studio.benchmark.place_errors import place_errors
from solver_backend.synthesis.studio.benchmark.solve_and_compare import solve_and_compare
from solver_backend.synthesis.studio.camera_arrays import build_camera_array
from solver_backend.synthesis.studio.contact_sheet import card_text
from solver_backend.synthesis.studio.data_set import SHOTS, make_data_set, plan, read_data_set
from solver_backend.synthesis.studio.spec import read_faults, spec_of
from solver_backend.types import Motion

ARRAY = {"preset": "azure_kinect_3", "scale": 0.3}
SMALL: dict[str, Any] = {
    "camera_arrays": [ARRAY], "frames": 5, "fps": 10, "film": ["infrared", "depth", "masks", "normals"],
    "people": {"count": 2},
    "write": ["pose2sim", "coco", "c3d", "trc"], "perturb": "detector", "seed": 9,
}  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("data set ü")
    make_data_set(spec_of(SMALL), out)
    return out


def digests(folder: Path) -> dict[str, str]:
    files = (p for p in sorted(folder.rglob("*")) if p.suffix in (".png", ".json", ".c3d", ".trc"))
    return {p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


@pytest.mark.slow
def test_a_run_that_was_ended_goes_on_with_the_same_pixels(made: Path, tmp_path: Path) -> None:
    class Ended(Exception):
        pass

    def stop(stage: str, done: int, total: int) -> None:
        if done == 8:
            raise Ended

    with pytest.raises(Ended):
        make_data_set(spec_of(SMALL), tmp_path, stop)
    assert sum((folder / "shot.json").is_file() for folder in (tmp_path / SHOTS).iterdir()) == 1
    make_data_set(spec_of(SMALL), tmp_path)
    assert digests(tmp_path / SHOTS) == digests(made / SHOTS)
    assert len(digests(made / SHOTS)) > 2 * 3 * 5 * 4


@pytest.mark.slow
def test_a_run_that_was_killed_goes_on_with_the_same_pixels(made: Path, tmp_path: Path) -> None:
    spec, out = tmp_path / "spec.json", tmp_path / "set"
    spec.write_text(json.dumps(SMALL))
    command = [sys.executable, "-m", "solver_backend", "dataset make", str(spec), "--out", str(out)]
    run = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    end = time.monotonic() + 120
    while not list(out.rglob("*.png")) and run.poll() is None and time.monotonic() < end:
        time.sleep(0.01)
    run.kill()
    run.wait()
    assert not (out / "card.md").exists(), "it was at work"
    for path in (out / SHOTS).glob(".part-*"):  # what is younger than a minute may be another process' work
        os.utime(path, (time.time() - 120,) * 2)
    make_data_set(spec_of(SMALL), out)
    assert digests(out / SHOTS) == digests(made / SHOTS)
    assert not list((out / SHOTS).glob(".part-*"))


def test_every_format_reads_back_as_what_was_filmed(made: Path) -> None:
    spec, records = read_data_set(made)
    assert len(records) == 2 and spec.frames == 5
    folder = made / SHOTS / records[0]["name"]
    clean = read_capture(folder / "clean.npz")
    trial = load_capture(folder / "pose2sim")
    assert trial.cameras is not None and trial.keypoints is not None and clean.cameras is not None
    assert np.allclose(trial.cameras.K, clean.cameras.K) and np.allclose(trial.cameras.t, clean.cameras.t)
    assert np.allclose(trial.cameras.distortion, clean.cameras.distortion)
    assert np.nanmax(np.abs(trial.keypoints.xy - clean.keypoints.xy)) < 1e-3
    assert trial.keypoints.joint_set is spec.joint_set and trial.fps == 10
    for name in ("markers.c3d", "markers.trc"):
        markers = load_capture(folder / name).markers
        assert markers is not None and markers.labels == clean.markers.labels
        assert np.abs(markers.positions - clean.markers.positions).max() < 1e-4
    motion = load_motion(folder / "motion.npz")
    assert isinstance(motion, Motion) and np.allclose(motion.joints, clean.truth["joints"], atol=1e-5)
    coco = json.loads((folder / "coco.json").read_text())
    assert len(coco["images"]) == 15 == len(coco["annotations"])
    with np.load(folder / "truth.npz") as truth:
        assert set(np.unique(truth["visibility_COCO_17"])) <= {0, 1, 2, 3}
        box = coco["annotations"][0]["bbox"]
        xy = truth["xy_COCO_17"][0, 0]
        assert (xy >= np.array(box[:2]) - 6).all() and (xy <= np.array(box[:2]) + box[2:] + 6).all()


def test_masks_depth_normals_and_boxes_agree(made: Path) -> None:
    record = read_data_set(made)[1][0]
    folder = made / SHOTS / record["name"]
    with np.load(folder / "truth.npz") as arrays:
        boxes = arrays["boxes"]
    for view, camera in enumerate(record["cameras"]):
        mask = read_png(folder / "masks" / camera / "000002.png")
        depth = read_png(folder / "depth" / camera / "000002.png")
        rows, columns = np.nonzero((mask >= 1) & (mask <= 6))
        found = np.array([columns.min(), rows.min(), columns.max(), rows.max()])
        assert np.abs(found - boxes[view, 2]).max() < 1.6
        person, room = (mask >= 1) & (mask <= 6) & (depth > 0), (mask == 9) & (depth > 0)
        assert np.median(depth[person]) < np.median(depth[room])
        normals = read_png(folder / "normals" / camera / "000002.png").astype(float) / 127.5 - 1
        assert np.abs(np.linalg.norm(normals, axis=-1) - 1).max() < 0.02
        assert (normals[person][:, 2] < 0.15).mean() > 0.98, "what is seen faces the camera"


@pytest.mark.slow
def test_the_benchmark_compares_clean_with_perturbed_and_reports_what_failed(made: Path) -> None:
    verdicts = solve_and_compare(made, ("frame", "triangulation"), faults=("clean", "perturbed"))
    assert len(verdicts) == 8 and not any(v.error for v in verdicts)
    by = {(v.method, v.faults): v.mpjpe_mm for v in verdicts}
    assert by["triangulation", "clean"] < 1.0 < by["triangulation", "perturbed"]
    assert by["frame", "clean"] < by["frame", "perturbed"]
    short = solve_and_compare(made, ("sliding",), ("markers",))
    assert "perturbed" in table(verdicts) and len(short) == 2
    page = page_html(made, "a <b>", verdicts)
    assert "a &lt;b&gt;" in page and "data:image/png;base64," in page and "<script" not in page


@pytest.mark.slow
def test_the_benchmark_solves_with_given_settings_and_compares_rigs_by_their_faults(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = tmp_path / "settings.json"
    said = []
    for smoothing in (1.0, 50.0):
        given.write_text(json.dumps({"smoothing": smoothing}))
        assert main(["dataset benchmark", str(made), "--settings", str(given), "--json"]) == 0
        said.append(json.loads(capsys.readouterr().out.splitlines()[-1])["rows"][0]["mpjpe_mm"])
    assert abs(said[0] - said[1]) > 0.1, "the settings reach the solve"
    given.write_text(json.dumps({"smoothness": 1}))
    assert main(["dataset benchmark", str(made), "--settings", str(given), "--json"]) == 2
    assert "smoothing" in json.loads(capsys.readouterr().out.splitlines()[-1])["hint"]
    spec, page = tmp_path / "rigs.json", tmp_path / "rigs.html"
    spec.write_text(json.dumps({"camera_arrays": ["oak_d_4"]}))
    asked = ["dataset cameras", str(spec), "--out", str(page), "--faults", "jitter", "detector", "--json"]
    assert main(asked) == 0
    medians = json.loads(capsys.readouterr().out.splitlines()[-1])["median_mm"]
    assert list(medians) == ["oak_d_4, jitter", "oak_d_4, detector"]
    assert medians["oak_d_4, jitter"] < medians["oak_d_4, detector"]
    text = page.read_text("utf-8")
    assert text.count("<svg") == 2
    left, top, wide, high = map(float, text.partition("viewBox='")[2].partition("'")[0].split())
    shown = re.findall(r'<path d="M(-?\d+) (-?\d+)h12', text)
    assert len(shown) == 2 * 4, "cameras stand outside the floor that is mapped, and are drawn"
    assert all(left < float(x) and float(x) + 12 < left + wide and top < float(y) < top + high for x, y in shown)


def test_the_card_counts_views_and_poses(made: Path) -> None:
    spec, records = read_data_set(made)
    text = card_text(spec, records, has_sheet=False)
    for words in (
        "Seen from",
        "Poses",
        "| knee bent |",
        "150 to 180",
        "| light | day (2) |",
        "CC0-1.0",
        "| seed | 9 |",
    ):
        assert words in text


@pytest.mark.slow
@pytest.mark.parametrize("array", [{"preset": "azure_kinect_3"}, {"count": 2, "size": [160, 120]}])
def test_room_that_is_said_before_is_enough_and_not_twice_too_much(tmp_path: Path, array: dict[str, Any]) -> None:
    kinds = ["infrared", "depth", "masks", "normals"]
    spec = spec_of({"camera_arrays": [array], "frames": 4, "fps": 2, "film": kinds, "write": ["pose2sim", "coco"]})
    needed = plan(spec).bytes
    make_data_set(spec, tmp_path)
    taken = sum(path.stat().st_size for path in (tmp_path / SHOTS).rglob("*") if path.is_file())
    assert 0.5 * needed < taken < needed


@pytest.mark.slow
def test_the_error_by_place_grows_with_the_noise_and_falls_with_the_cameras() -> None:
    ring = {"count": 6, "radius_m": 3.0, "size": [640, 480]}
    few, many = build_camera_array({**ring, "count": 2, "turn_deg": 0}), build_camera_array(ring)
    small = {"half_m": 0.5, "step_m": 0.5}
    quiet = place_errors(many, read_faults({"jitter_mm": 3}), **small)
    loud = place_errors(many, read_faults({"jitter_mm": 12}), **small)
    two = place_errors(few, read_faults({"jitter_mm": 12}), **small)
    assert 2.5 < np.nanmedian(loud.error_mm) / np.nanmedian(quiet.error_mm) < 5.5
    assert quiet.views.mean() > 3 * two.views.mean() / 2
    assert not np.isfinite(two.error_mm).any() or np.nanmedian(two.error_mm) > np.nanmedian(loud.error_mm)


def test_the_command_line_makes_a_data_set_and_names_its_errors(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    spec = tmp_path / "spec.json"
    spec.write_text(json.dumps({"film": ["masks"], "frames": 2, "camera_arrays": [ARRAY]}))
    assert main(["dataset make", str(spec), "--out", str(tmp_path / "set"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert said["event"] == "result" and said["frames"] == 2 and said["needed_mb"] > 0
    assert (tmp_path / "set" / "card.md").is_file() and (tmp_path / "set" / "contact_sheet.png").is_file()
    spec.write_text(json.dumps({"camera_arrays": ["nobody_has_it"]}))
    assert main(["dataset make", str(spec), "--out", str(tmp_path / "other"), "--json"]) == 2
    said = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert said["code"] == "studio_invalid" and "azure_kinect_3" in said["hint"]
