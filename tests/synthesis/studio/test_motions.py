"""Motions to film: takes, AMASS clips, BVH files, folders of them and the choreography, all on our floor."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.exchange.errors import FileMissing, MocapError
from solver_backend.io.native.motion_file import write_motion
from solver_backend.synthesis.embedded.demo import author_motion
from solver_backend.synthesis.studio.data_set import open_data_set
from solver_backend.synthesis.studio.motions import find_motions
from solver_backend.synthesis.studio.spec import spec_of
from solver_backend.synthesis.studio.stage import list_shots, require_sight, set_up
from solver_backend.synthesis.studio.truth import true_motion
from solver_backend.types import JointSet

FPS = 30.0


def amass(path: Path, frames: int = 40, width: int = 156) -> Path:
    """Write the choreography as an AMASS clip."""
    motion = author_motion(load_body(), np.zeros(10), frames, FPS)
    poses = np.zeros((frames, width))
    poses[:, :3], poses[:, 3:66] = motion.global_orient, motion.body_pose.reshape(frames, 63)
    np.savez(path, poses=poses, trans=motion.transl, betas=np.zeros(16), gender="neutral", mocap_framerate=FPS)
    return path


def test_a_take_and_an_amass_clip_move_as_what_they_were_written_of(tmp_path: Path) -> None:
    amass(tmp_path / "clip.npz")
    body, betas = load_body(), np.zeros(10)
    true = find_motions(["choreography"])[0].play(body, betas, FPS, 40)
    joints = true.landmarks(JointSet.SMPL_24).points
    write_motion(tmp_path / "take.npz", true_motion(true, joints, np.zeros((40, 2), bool), FPS))
    for name in ("clip.npz", "take.npz"):
        found = find_motions([name], tmp_path)[0].play(body, betas, FPS, 40)
        assert len(found.transl) == 40
        assert np.abs(found.local - true.local).max() < 1e-4 and np.abs(found.orient - true.orient).max() < 1e-4
        move = found.landmarks(JointSet.SMPL_24).points - joints
        assert np.abs(move - move[:1])[..., :2].max() < 1e-3 and np.abs(move[..., 2]).max() < 0.03, "the floor's alone"


def test_half_the_rate_takes_every_other_frame(tmp_path: Path) -> None:
    amass(tmp_path / "a.npz")
    body = load_body()
    whole = find_motions(["a.npz"], tmp_path)[0].play(body, np.zeros(10), FPS, 100)
    half = find_motions(["a.npz"], tmp_path)[0].play(body, np.zeros(10), FPS / 2, 100)
    assert len(whole.transl) == 40 and len(half.transl) == 20
    assert np.abs(half.local - whole.local[::2]).max() < 1e-9 and np.abs(half.transl - whole.transl[::2]).max() < 1e-9


def test_recorded_bvh_files_of_three_families_are_filmed_and_stand_on_the_floor(shared_data: Path) -> None:
    folder = shared_data / "bvh_samples"
    spec = spec_of(
        {"motions": ["bvh_samples"], "frames": 30, "fps": 10, "camera_arrays": [{"count": 4}]}, folder.parent
    )
    shots = list_shots(spec)
    assert len(shots) == len(list(folder.glob("*.bvh"))) >= 3
    for shot in shots:
        stage = set_up(spec, shot)
        require_sight(stage)
        lowest = stage.person.skin(np.arange(stage.num_frames))[..., 2].min(axis=1)
        assert -0.05 < lowest.min() < 0.03, shot.name
        assert 10 < stage.num_frames <= 30
        upright = stage.joints[:, 15, 2] - stage.joints[:, [7, 8], 2].min(axis=1)
        assert np.median(upright) > 1.0, "head over feet"


def test_a_folder_is_all_its_motions_and_equal_names_are_told_apart(tmp_path: Path) -> None:
    for part in ("one", "two/deep"):
        (tmp_path / part).mkdir(parents=True)
        amass(tmp_path / part / "walk.npz")
    (tmp_path / "one" / "notes.txt").write_text("not a motion")
    found = find_motions(["choreography", "."], tmp_path)
    assert [source.name for source in found] == ["choreography", "walk", "walk~2"]
    (tmp_path / "none").mkdir()
    with pytest.raises(FileMissing, match="no motions"):
        find_motions(["none"], tmp_path)


@pytest.mark.parametrize("width", [30, 63])
def test_a_clip_of_other_joints_is_refused_before_anything_is_made(tmp_path: Path, width: int) -> None:
    np.savez(tmp_path / "a.npz", poses=np.zeros((9, width)), trans=np.zeros((9, 3)), mocap_framerate=30.0)
    spec = spec_of({"motions": ["a.npz"], "frames": 5}, tmp_path)
    with pytest.raises(MocapError):
        open_data_set(spec, tmp_path / "out")
    assert not (tmp_path / "out").exists()
