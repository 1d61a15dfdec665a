"""Acclaim files: the tree, axes of bones, and that two conversions of one recording agree."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import FileDamaged, FileMissing
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.io.motions.recorded_clip import body_rotations
from training.data.sources.amc_clips import read_amc
from training.data.sources.clips import read_clip

ASF = """:version 1.10
:root
   order TX TY TZ RX RY RZ
:bonedata
  begin
     id 1
     name shin
     axis 0 0 20  XYZ
    dof rx
  end
  begin
     id 2
     name thigh
     axis 10 0 0  XYZ
    dof rx rz
  end
:hierarchy
  begin
    root thigh
    thigh shin
  end
"""


def test_bones_turn_about_their_own_axes(tmp_path: Path) -> None:
    asf, amc = tmp_path / "s.asf", tmp_path / "m.amc.gz"
    asf.write_text(ASF)
    rows = "".join(f"{k}\nroot 1 2 3 0 {10 * k} 0\nthigh {5 * k} 30\nshin {20 * k}\n" for k in (1, 2))
    amc.write_bytes(gzip.compress(f"#!x\n:DEGREES\n{rows}".encode()))
    clip = read_amc(amc, asf)
    assert clip.joint_names == ["root", "thigh", "shin"] and clip.parents.tolist() == [-1, 0, 1]
    assert clip.rotvec.shape == (2, 3, 3) and clip.fps == 120.0 and clip.name == "m"
    np.testing.assert_allclose(clip.rotvec[:, 0], np.radians([[0, 10, 0], [0, 20, 0]]), atol=1e-12)
    axis = exp_so3(np.radians([0.0, 0.0, 20.0])) @ np.array([1.0, 0.0, 0.0])
    np.testing.assert_allclose(clip.rotvec[:, 2], np.radians([[20.0], [40.0]]) * axis, atol=1e-12)
    C = exp_so3(np.radians([10.0, 0.0, 0.0]))
    turn = exp_so3(np.radians([0.0, 0.0, 30.0])) @ exp_so3(np.radians([10.0, 0.0, 0.0]))
    np.testing.assert_allclose(exp_so3(clip.rotvec[1, 1]), C @ turn @ C.T, atol=1e-12)


def test_bad_files_are_named(tmp_path: Path) -> None:
    asf, amc = tmp_path / "s.asf", tmp_path / "m.amc"
    asf.write_text(ASF)
    with pytest.raises(FileMissing, match=r"m\.amc"):
        read_amc(amc, asf)
    amc.write_text("1\nroot 0 0 0 0 0 0\nelbow 3\n")
    with pytest.raises(FileDamaged, match="an unknown bone"):
        read_amc(amc, asf)
    packed = tmp_path / "m.amc.gz"
    packed.write_text("1\n")
    with pytest.raises(FileDamaged, match="not gzipped"):
        read_amc(packed, asf)
    whole = gzip.compress(amc.read_bytes() * 20)
    for bad in (whole[:-12], whole[:20] + bytes([whole[20] ^ 255]) + whole[21:]):
        packed.write_bytes(bad)
        with pytest.raises(FileDamaged, match="is damaged"):
            read_amc(packed, asf)


@pytest.mark.shared
def test_agrees_with_another_conversion(shared_data: Path) -> None:
    folder = shared_data / "motion_cmu"
    ours = body_rotations(read_amc(folder / "amc" / "13_29.amc.gz", folder / "amc" / "11.asf"))
    theirs = body_rotations(read_clip(folder / "mb2" / "13_29.npz"))
    difference = log_so3(np.swapaxes(ours[2:4000:2], -1, -2) @ theirs[:1999])
    angle = np.degrees(np.linalg.norm(difference, axis=-1)).mean(axis=0)
    # Elbows and wrists differ as that conversion has no wrist joint of its own.
    others = [j for j in range(22) if j not in (18, 19, 20, 21)]
    assert angle[others].max() < 0.1
