"""Every public C3D file at hand is read or refused by name, and read as another program reads it."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import ezc3d
import numpy as np
import pytest

from solver_backend.exchange.errors import FileDamaged, MocapError, NoDetections
from solver_backend.io.markers.c3d import read_c3d
from solver_backend.io.markers.camera_systems import read_nexus_csv
from solver_backend.io.markers.source import MarkerTake
from solver_backend.io.units_and_axes import rotation_to_z_up
from tests.support.marker_reading import stated, taken
from tests.support.words import codes

FOLDERS = {
    "btkdata": 64,
    "ezc3d_momentum": 18,
    "opensim": 2,
    "pycgm": 2,
    "cmu_pairs": 2,
    "nimble": 1,
    "automarkerlabel": 3,
}
"""Number of C3D files in each."""
REFUSED = {
    "Empty.c3d": FileDamaged,
    "1123x01EMG.c3d": NoDetections,  # muscles only
    "Analysis.c3d": NoDetections,  # joint angles only
    "parameterOverflow.c3d": NoDetections,  # all points are 0
}
UNREAD_BY_ORACLE = {
    "Eb015si", "Eb015sr", "sgi_int", "sgi_real", "MACsample", "phasespace_sample", "Dance", "golfswing",
    "bad_parameter_section", "badParameterOffset", "mocap36", "BKINtechnologies",
    "dynamic", "standing", "type1", "561xxa01_anonym",
}  # fmt: skip
"""ezc3d knows no MIPS numbers, finds no points in a file without parameters, refuses files with parameters as they
should not be, and reads frames of those in the last line, which state no ANALOG:RATE, with too few analog samples."""
SMOOTH = ("dynamic", "standing", "type1", "561xxa01_anonym", "MACsample", "mocap36", "bad_parameter_section")
"""Recordings of people at 60 Hz and more that no other program confirms: markers must move as people do."""
SAMPLE02 = ("Dec_real", "pc_int", "pc_real", "sgi_int", "sgi_real")
SAME_TAKE = [
    [f"sample01/Eb015{kind}.c3d" for kind in ("pi", "pr", "si", "sr", "vi", "vr")],
    [f"sample02/{kind}.{end}" for kind, end in [("DEC_INT", "C3D"), *((kind, "c3d") for kind in SAMPLE02)]],
    [f"sample08/TEST{kind}PI.c3d" for kind in "ABCD"],
]  # fmt: skip
"""Files of one recording in every number, and with the sections at every place."""


def c3d_files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.suffix.lower() == ".c3d")


@cache
def outcome(path: Path) -> MarkerTake | MocapError:
    try:
        return taken(read_c3d, path)
    except MocapError as error:
        return error


@pytest.mark.shared
@pytest.mark.parametrize("name", FOLDERS)
def test_every_file_is_read_or_refused_by_name(shared_data: Path, name: str) -> None:
    files = c3d_files(shared_data / "markers" / name)
    assert len(files) == FOLDERS[name]
    for path in files:
        found = outcome(path)
        if isinstance(found, MocapError):
            assert type(found) is REFUSED.get(path.name), f"{path.name}: {found}"
            continue
        assert path.name not in REFUSED
        positions = found.cloud.positions
        assert positions.shape[0] == stated(found).frames
        assert np.isfinite(positions).any()
        assert (np.isnan(positions).any(axis=-1) == np.isnan(positions).all(axis=-1)).all()


@pytest.mark.shared
@pytest.mark.parametrize("name", FOLDERS)
def test_values_equal_those_of_another_reader(shared_data: Path, name: str) -> None:
    compared = 0
    for path in c3d_files(shared_data / "markers" / name):
        found = outcome(path)
        if isinstance(found, MocapError) or path.stem in UNREAD_BY_ORACLE:
            continue
        oracle = ezc3d.c3d(str(path))
        points, residuals = oracle["data"]["points"][:3], oracle["data"]["meta_points"]["residuals"][0]
        ours, kept = _as_stored(found), _kept(found, oracle)
        theirs, residuals = points[:, kept].transpose(2, 1, 0)[: len(ours)], residuals[kept].T[: len(ours)]
        seen = np.isfinite(ours[..., 0])
        np.testing.assert_allclose(ours[seen], theirs[seen], rtol=3e-7, atol=1e-9, err_msg=path.name)
        unseen = np.isnan(theirs).any(axis=-1) | (theirs == 0).all(axis=-1) | (residuals < 0)
        assert unseen[~seen].all(), path.name
        assert not (np.isnan(theirs).any(axis=-1) & seen).any(), path.name
        compared += 1
    assert compared >= min(FOLDERS[name], 1)


def _as_stored(found: MarkerTake) -> np.ndarray:
    """Return the positions in the file's unit and axes."""
    metres = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}[stated(found).unit]
    return found.cloud.positions @ rotation_to_z_up(stated(found).up_axis) / metres


def _kept(found: MarkerTake, oracle: ezc3d.c3d) -> list[int]:
    """Return the oracle's indices of our markers: those of its points whose labels we read, in order."""
    points = oracle["data"]["points"].shape[1]
    point = oracle["parameters"]["POINT"]
    labels = [label for name in ("LABELS", "LABELS2") if name in point for label in point[name]["value"]][:points]
    ours = found.cloud.positions.shape[1]
    if ours == points or found.cloud.labels is None:
        return list(range(points))
    wanted = {label.split(" (")[0] for label in found.cloud.labels}
    kept = [i for i, label in enumerate(labels) if label.split(" (")[0] in wanted or not label]
    assert len(kept) == ours
    return kept


@pytest.mark.shared
def test_what_no_other_reader_confirms_moves_as_people_do(shared_data: Path) -> None:
    files = {path.stem: path for path in c3d_files(shared_data / "markers/btkdata")}
    for name in SMOOTH:
        steps = np.linalg.norm(np.diff(taken(read_c3d, files[name]).cloud.positions, axis=0), axis=-1)
        assert np.nanpercentile(steps, 95) < 0.08, name


@pytest.mark.shared
@pytest.mark.parametrize("names", SAME_TAKE, ids=["sample01", "sample02", "sample08"])
def test_one_recording_in_every_kind_of_number(shared_data: Path, names: list[str]) -> None:
    folder = shared_data / "markers/btkdata/Input/C3DSamples/c3d.org"
    takes = [taken(read_c3d, folder / name) for name in names]
    first = takes[0].cloud
    for take, name in zip(takes[1:], names[1:], strict=True):
        assert take.cloud.labels == first.labels
        # One step of the integers is up to 0.28 mm; some of these files were rounded, others cut.
        np.testing.assert_allclose(take.cloud.positions, first.positions, atol=2.9e-4, err_msg=name)


@pytest.mark.shared
def test_what_is_recognised(shared_data: Path) -> None:
    folder = shared_data / "markers"
    cmu = taken(read_c3d, folder / "cmu_pairs/02_01.c3d")
    assert (len(cmu.cloud.positions), cmu.cloud.fps) == (343, 120.0)
    assert (cmu.subjects, stated(cmu).unit, stated(cmu).up_axis) == (("TakeoMonday",), "mm", "z")
    squat = taken(read_c3d, folder / "nimble/c3d/squat.c3d")
    assert stated(squat).up_axis == "y" and "up_axis_read" in codes(squat.notes)
    gait = taken(read_c3d, folder / "btkdata/Input/C3DSamples/PiG/PiG_Motion-FlatFoot-Full.c3d")
    assert len(stated(gait).analog_channels) == 38


@pytest.mark.shared
def test_the_same_trial_from_c3d_and_from_csv(shared_data: Path) -> None:
    folder = shared_data / "markers/pycgm/ROM"
    binary, text = taken(read_c3d, folder / "Sample_Static.c3d"), taken(read_nexus_csv, folder / "Sample_Static.csv")
    assert (len(binary.cloud.positions), binary.cloud.fps) == (len(text.cloud.positions), text.cloud.fps)
    assert binary.cloud.labels is not None and text.cloud.labels is not None
    shared = [label for label in binary.cloud.labels if label in text.cloud.labels]
    assert len(shared) > 100
    columns = [
        [take.cloud.labels.index(label) for label in shared]  # type: ignore[union-attr]
        for take in (binary, text)
    ]
    np.testing.assert_allclose(binary.cloud.positions[:, columns[0]], text.cloud.positions[:, columns[1]], atol=1e-6)
