"""Acclaim's ASF and AMC: pairs by either file, against the same take converted by others, and damaged files."""

from __future__ import annotations

import gzip
import re
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import FileDamaged, FileMissing, NonFiniteData
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.motions.acclaim import find_pair, read_acclaim
from solver_backend.io.motions.foreign_skeleton import read_foreign_clip
from tests.support.acclaim_skeleton import AMC, ASF


def pair(folder: Path, asf: str = ASF, amc: str = AMC, names: tuple[str, str] = ("07.asf", "07_01.amc")) -> Path:
    (folder / names[0]).write_text(asf)
    (folder / names[1]).write_text(amc)
    return folder / names[1]


def _frame(number: int) -> str:
    """Return the last frame of the motion with another number."""
    return f"{number}\n" + AMC.split("\n2\n")[1]


def test_bones_turn_about_the_axes_of_the_skeleton(tmp_path: Path) -> None:
    motion = read_acclaim(pair(tmp_path), 60.0)
    assert motion.fps == 60.0 and motion.names == ("root", "thigh", "shin", "shin_end")
    assert np.allclose(motion.rest, [[0, 0, 0], [0, 0, 0], [0, -8, 0], [0, -15, 0]])
    assert np.allclose(motion.joints[0], [[1, 20, 3], [1, 20, 3], [1, 12, 3], [1, 5, 3]])
    about = {axis: np.eye(3)[k] for k, axis in enumerate("xyz")}

    def turn(axis: str, degrees: float) -> np.ndarray:
        return np.asarray(exp_so3(np.radians(degrees) * about[axis]))

    C = turn("z", 20)
    thigh = turn("y", 90) @ C @ turn("z", 5) @ turn("y", -10) @ turn("x", 30) @ C.T
    assert np.allclose(motion.turns[1, 1], thigh)
    assert np.allclose(motion.turns[1, 2], thigh @ C @ turn("x", 60) @ C.T)
    assert np.allclose(motion.joints[1, 2], [1, 20, 3] + thigh @ [0, -8, 0])


def test_the_motion_says_if_its_angles_are_in_radians(tmp_path: Path) -> None:
    degrees = read_acclaim(pair(tmp_path)).turns
    own = [line.split() for line in AMC.splitlines() if not line.startswith((":", "#"))]
    for words in own:
        turns = slice(4, None) if words[0] == "root" else slice(1, None)
        words[turns] = [f"{np.radians(float(word)):.12f}" for word in words[turns]]
    amc = ":RADIANS\n" + "\n".join(" ".join(words) for words in own) + "\n"
    assert np.allclose(read_acclaim(pair(tmp_path, amc=amc)).turns, degrees, atol=1e-9), "the axes are in degrees"


@pytest.mark.parametrize("skeleton", ["02.asf", "131-dance.asf"])
def test_files_with_the_numbers_of_two_subjects_are_no_pair(tmp_path: Path, skeleton: str) -> None:
    for path in (pair(tmp_path, names=(skeleton, "13_29.amc")), tmp_path / skeleton):
        with pytest.raises(FileMissing, match="of the pair is missing"):
            find_pair(path)
    (tmp_path / skeleton).rename(tmp_path / "actor.asf")
    assert find_pair(tmp_path / "13_29.amc")[0].name == "actor.asf"


@pytest.mark.parametrize("actor", ["subject {}", "actor-{}", "P.0{}"])
def test_separators_in_a_name_before_a_number_belong_to_the_name(tmp_path: Path, actor: str) -> None:
    one, two = (pair(tmp_path, names=(f"{actor.format(n)}.asf", f"{actor.format(n)}_walk.amc")) for n in (1, 2))
    assert [find_pair(amc)[0].stem for amc in (one, two)] == [actor.format(1), actor.format(2)]


def test_actors_with_the_same_first_name_are_no_pair(tmp_path: Path) -> None:
    pair(tmp_path, names=("bob.asf", "anna-may.amc"))
    (tmp_path / "anna-lee.asf").write_text(ASF)
    with pytest.raises(FileMissing, match="2 files could be the skeleton"):
        find_pair(tmp_path / "anna-may.amc")


def test_a_pair_is_found_by_either_file(tmp_path: Path) -> None:
    amc = pair(tmp_path)
    asf = tmp_path / "07.asf"
    assert find_pair(amc) == find_pair(asf) == (asf, amc)
    (tmp_path / "08.asf").write_text(ASF)
    assert find_pair(amc) == (asf, amc), "the number of the subject decides"
    (tmp_path / "07_02.amc").write_text(AMC)
    assert find_pair(tmp_path / "07_02.amc") == (asf, tmp_path / "07_02.amc")
    with pytest.raises(FileMissing, match="2 files could be the motion") as found:
        find_pair(asf)
    assert "07_01.amc, 07_02.amc" in str(found.value.hint)
    asf.unlink()
    (tmp_path / "08.asf").unlink()
    with pytest.raises(FileMissing, match=re.escape("The skeleton (ASF) of the pair is missing")):
        read_acclaim(amc)


@pytest.mark.parametrize(
    ("asf", "amc", "error", "match"),
    [
        (ASF, AMC.replace("shin 60", "shin 60 1"), FileDamaged, "2 numbers instead of 1"),
        (ASF, AMC.replace("shin 60", "tail 60"), FileDamaged, "an unknown bone"),
        (ASF, AMC.replace("shin 60\n", ""), FileDamaged, "'shin' is missing in a frame"),
        (ASF, AMC.replace("shin 60\n", "shin 60\nshin 60\n"), FileDamaged, "occurs twice before frame 2"),
        (ASF, AMC + _frame(3).replace("shin 60\n", "") + _frame(4), FileDamaged, "occurs twice before frame 4"),
        (ASF, AMC + _frame(30), FileDamaged, "Frame 30 comes after frame 2"),
        (ASF, AMC + "3" * 5000 + "\n", FileDamaged, "Frame 2 has an unknown bone"),
        (ASF, AMC + "\u00b2\n", FileDamaged, "Frame 2 has an unknown bone"),
        (ASF.replace("   order TX TY TZ RX RY RZ\n", ""), AMC, FileDamaged, "root has no 'order'"),
        (ASF.replace("dof rx ry rz", "dof rx ry ry", 1), AMC, FileDamaged, "line of the skeleton is not valid"),
        (ASF.replace("dof rx ry rz", "dof rx ry tz", 1), AMC, FileDamaged, "'thigh' has the unsupported channel 'tz'"),
        (ASF, AMC.replace("shin 60", "shin x"), NonFiniteData, "not a number"),
        (ASF, AMC.replace("shin 60", "shin nan"), NonFiniteData, "shin"),
        (ASF.replace("    thigh shin\n", ""), AMC, FileDamaged, "not connected to the root: shin"),
        (ASF.replace("thigh shin", "thigh shin\n    shin thigh"), AMC, FileDamaged, "not connected to the root"),
        (ASF.replace("direction 0 -1 0", "direction 0 -1", 1), AMC, FileDamaged, "line of the skeleton is not valid"),
        (ASF, "1\n", FileDamaged, ""),
    ],
)
def test_what_is_wrong_is_named_with_its_place(
    tmp_path: Path, asf: str, amc: str, error: type[Exception], match: str
) -> None:
    path = pair(tmp_path, asf, amc)
    if not match:
        assert (read_acclaim(path).joints == 0.0)[:, 0].all(), "bones that frames leave out are at rest"
        return
    with pytest.raises(error, match=match):
        read_acclaim(path)


def test_a_take_of_cmu_is_as_others_converted_it(shared_data: Path, tmp_path: Path) -> None:
    """The rotations of every bone and the place of the root, against an independent conversion of the same take."""
    folder = shared_data / "motion_cmu"
    text = gzip.decompress((folder / "amc" / "14_14.amc.gz").read_bytes()).decode()
    short = re.split(r"(?m)^401\s*$", text)[0]
    motion = read_acclaim(pair(tmp_path, (folder / "amc" / "11.asf").read_text(), short, ("14.asf", "14_14.amc")))
    with np.load(folder / "asfamc" / "14_14.npz") as clip:
        names, parents = [str(name) for name in clip["names"]], clip["parents"]
        rotvec, root = clip["rotvec"][:100].astype(float), clip["root"][:100]
        rotvec[:, 0] = clip["root_rotvec"][:100]
    local = np.asarray(exp_so3(rotvec))
    G = np.empty_like(local)
    for j, parent in enumerate(parents):
        G[:, j] = local[:, j] if parent < 0 else G[:, parent] @ local[:, j]
    columns = [motion.names.index(name) for name in names]
    assert np.abs(motion.turns[::4][:, columns] - G).max() < 0.003, "rounded to 16 bits there"
    assert np.abs(0.0564444 * motion.joints[::4, 0] - root).max() < 1e-4


def test_a_take_of_cmu_becomes_a_clip_of_a_person(shared_data: Path, tmp_path: Path) -> None:
    folder = shared_data / "motion_cmu" / "amc"
    text = gzip.decompress((folder / "11_01.amc.gz").read_bytes()).decode()
    short = re.split(r"(?m)^61\s*$", text)[0]
    path = pair(tmp_path, (folder / "11.asf").read_text(), short, ("11.asf", "11_01.amc"))
    clip, roles, found = read_foreign_clip(path)
    codes = {item.code for item in found}
    assert "frame_rate_assumed" in codes and clip.fps == 120.0
    head, foot = (clip.joints[:, clip.names.index(roles[role]), 2] for role in ("head", "left_foot"))
    assert (head - foot > 1.2).all(), "metres, Z up"
    assert "frame_rate_assumed" not in {item.code for item in read_foreign_clip(path, fps=60.0)[2]}
