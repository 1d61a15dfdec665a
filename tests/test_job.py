"""Job files: what they may say, and what is refused with which words."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from solver_backend.exchange.errors import FileDamaged, FileMissing, JobInvalid
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.job import Job
from solver_backend.types import JointSet

MINIMAL = {"version": 1, "capture": "take", "out": "motion.npz"}


def full_job() -> Job:
    return Job(
        capture=Path("/takes/one"),
        out=Path("/results/one.npz"),
        report=Path("/results/one.html"),
        overwrite=True,
        fps=59.94,
        trim=True,
        joint_set=JointSet.HALPE_26,
        settings=SolveSettings(method="frame", backend="torch", robust_scale=2.5, betas=(0.5,) * 10),
    )


def test_a_job_survives_the_round_trip_through_json(tmp_path):
    path = tmp_path / "job.json"
    path.write_text(json.dumps(full_job().as_dict()), encoding="utf-8")
    assert Job.read(path) == full_job()


def test_relative_paths_start_at_the_job_file(tmp_path):
    path = tmp_path / "job.json"
    path.write_text(json.dumps({**MINIMAL, "report": "page.html"}), encoding="utf-8")
    job = Job.read(path)
    assert (job.capture, job.out) == (tmp_path / "take", tmp_path / "motion.npz")
    assert job.report == tmp_path / "page.html"
    assert job.settings == SolveSettings()
    assert not job.overwrite


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"methd": "frame"},
            r"Unknown key methd \(job\)\. Known keys: as_calibrated, by_order, camera, camera_path, capture, fps",
        ),
        ({"settings": {"windw": 3}}, r"Unknown setting windw\. Known settings: method, window, refine_window"),
        ({"settings": {"window": 3}}, r"window = 3 is not valid. It must be a whole number from 4 to 240"),
        (
            {"settings": {"residual_rotations": "no"}},
            r"rotations = 'no' is not valid. It must be true or false",
        ),
        (
            {"settings": {"robust_scale": "wide"}},
            r"robust_scale = 'wide' is not valid. It must be a number from 0\.1 to 100",
        ),
        ({"settings": {"betas": 3}}, r"betas = 3 is not valid. It must be a list of 10 numbers"),
        ({"settings": ["frame"]}, r"settings is \['frame'\], but an object is expected"),
        ({"version": 2}, r"The job has version 2, but 1 is needed"),
        ({"version": None}, r"The job has version None, but 1 is needed.*Write \"version\": 1"),
        ({"capture": None}, r"The job has no capture"),
        ({"capture": None, "out": None}, r"The job has no capture and out"),
        ({"out": 3}, r"out is 3, but text is expected"),
        ({"fps": True}, r"fps is True, but a number is expected"),
        ({"fps": 0}, r"frame rate must be a positive number, not 0"),
        ({"fps": float("nan")}, r"frame rate must be a positive number, not nan"),
        ({"overwrite": 1}, r"overwrite is 1, but true or false is expected"),
        ({"joint_set": "BODY_26"}, r"There is no joint set 'BODY_26'.*Known sets: BODY_25, BODY_25B, COCO_17"),
        ({"out": "motion.bvh"}, r"A motion file must end in \.npz.*Try motion\.bvh\.npz"),
        ({"capture": "motion.npz"}, r"must be different files"),
        ({"report": "sub/../motion.npz"}, r"must be different files"),
        ({"capture": "a\0b.npz"}, r"contains the character U\+0000"),
        ({"report": "a\0.html"}, r"contains the character U\+0000"),
        ({"settings": {"layout": "a\0.json"}}, r"contains the character U\+0000"),
    ],
)
def test_what_is_wrong_is_named(change, message):
    with pytest.raises(JobInvalid, match=message):
        Job.from_dict({**MINIMAL, **change})


def test_a_file_that_is_no_job(tmp_path):
    with pytest.raises(FileMissing, match="There is no such file"):
        Job.read(tmp_path / "absent.json")
    path = tmp_path / "job.json"
    path.write_text('{"version": 1, "cap', encoding="utf-8")
    with pytest.raises(FileDamaged, match="truncated or is not JSON"):
        Job.read(path)
    path.write_text("[1]", encoding="utf-8")
    with pytest.raises(JobInvalid, match="does not contain a JSON object"):
        Job.read(path)


def test_a_stretch_to_solve_again_is_read_relative_to_the_job_and_written_back(tmp_path):
    pin = {"frame": 5, "global_orient": [0.0] * 3, "body_pose": [0.1] * 69, "transl": [0.0, 0.0, 1.0]}
    values = {**MINIMAL, "resolve": {"motion": "earlier.npz", "first": 2, "last": 9, "pins": [pin]}}
    job = Job.from_dict(values, tmp_path)
    assert job.resolve is not None and job.resolve.motion == tmp_path / "earlier.npz"
    assert Job.from_dict(job.as_dict()).as_dict() == job.as_dict()
    with pytest.raises(JobInvalid, match="`resolve` has no `motion`"):
        Job.from_dict({**MINIMAL, "resolve": {"first": 2, "last": 9}})
    with pytest.raises(JobInvalid, match="must be different files"):
        Job.from_dict({**MINIMAL, "resolve": {"motion": MINIMAL["out"], "first": 2, "last": 9}})


def test_the_path_of_a_body_is_relative_to_the_job_file(tmp_path):
    values = {"version": 1, "capture": "take", "out": "motion.npz"}
    for body, expected in (("anny", "anny"), ("bodies/smpl.pkl", str(tmp_path / "bodies" / "smpl.pkl"))):
        job = Job.from_dict({**values, "settings": {"body": body}}, tmp_path)
        assert job.settings.body == expected
        assert Job.from_dict(job.as_dict()) == job


def test_time_of_cameras_is_read_back(tmp_path):
    values = {
        "version": 1,
        "capture": "take",
        "out": "m.npz",
        "offset": ["cam2=60"],
        "by_order": True,
        "frames": [5, 9],
    }
    job = Job.from_dict(values, tmp_path)
    assert (job.offset, job.by_order, job.frames) == (("cam2=60",), True, (5, 9))
    assert Job.from_dict(job.as_dict()) == job
    for wrong in ({"offset": ["cam2"]}, {"frames": [9, 5]}, {"frames": [1]}, {"offset": [3]}):
        with pytest.raises(JobInvalid):
            Job.from_dict(values | wrong, tmp_path)
