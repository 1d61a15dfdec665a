"""Several people and several trials, from the command line to a motion file each."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from solver_backend.cli.main import main
from solver_backend.exchange.errors import PersonUnknown
from solver_backend.io.load import load_capture
from solver_backend.io.native.capture_file import read_capture, write_capture
from solver_backend.io.native.motion_file import read_motion

SESSION = Path("multiview", "pose2sim_session")
PAIR = SESSION / "S00_P01_MultiParticipants" / "S00_P01_T02_Participants1-2"


@pytest.fixture(scope="module")
def short_pair(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a capture file with the first twelve frames of a recording of two people, and a third in two views."""
    whole = load_capture(shared_data / PAIR)
    from dataclasses import replace

    assert whole.keypoints is not None
    people = tuple(replace(p, keypoints=p.keypoints.frames(0, 12)) for p in whole.people)
    cut = replace(whole, keypoints=whole.keypoints.frames(0, 12), people=people)
    return write_capture(tmp_path_factory.mktemp("zwei") / "pair.npz", cut)


def last_event(capsys: pytest.CaptureFixture[str]) -> dict:
    return json.loads(capsys.readouterr().out.splitlines()[-1])


def test_people_lists_everybody(shared_data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(shared_data / PAIR), "--json"]) == 0
    listed = last_event(capsys)["people"]
    assert [p["name"] for p in listed] == ["Person 1", "Person 2", "Person 3"]
    assert [p["frames"] for p in listed] == [100, 100, 100]
    assert listed[0]["views"] > 3.9 and listed[1]["views"] > 3.9 and listed[2]["views"] == pytest.approx(2.0, abs=0.1)


def test_a_person_is_chosen_late_by_name_or_number(short_pair: Path) -> None:
    whole = read_capture(short_pair)
    assert whole.person == "Person 1" and len(whole.people) == 3
    second = load_capture(short_pair, person="person 2")
    assert second.person == "Person 2" and second.keypoints is not None
    np.testing.assert_array_equal(second.keypoints.xy, load_capture(short_pair, person="2").keypoints.xy)
    assert np.nanmax(np.abs(second.keypoints.xy - whole.keypoints.xy)) > 50
    with pytest.raises(PersonUnknown, match="no person 'Anna'") as error:
        load_capture(short_pair, person="Anna")
    assert "Person 1, Person 2, Person 3" in error.value.hint


@pytest.mark.slow
def test_solve_all_writes_a_motion_a_person(short_pair: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / "take_01.npz"
    assert main(["solve", str(short_pair), "--out", str(out), "--person", "all", "--json"]) == 0
    result = last_event(capsys)
    assert [Path(t["motion"]).name for t in result["takes"]] == [f"take_01_person_{n}.npz" for n in (1, 2, 3)]
    assert not result["failed"] and not out.exists()
    motions = [read_motion(t["motion"]) for t in result["takes"]]
    assert [m.provenance["person"] for m in motions] == ["Person 1", "Person 2", "Person 3"]
    apart = np.linalg.norm(motions[0].transl[:, :2] - motions[1].transl[:, :2], axis=-1)
    assert apart.min() > 0.8  # one walks, the other sits beside
    # Frames solved again are those of the person of the earlier motion.
    again = tmp_path / "again.npz"
    earlier = result["takes"][1]["motion"]
    job = ["--resolve", earlier, "--frames", "4", "8", "--out", str(again), "--json"]
    assert main(["solve", str(short_pair), *job]) == 0
    assert np.abs(read_motion(again).transl - motions[1].transl).max() < 0.1


@pytest.mark.slow
def test_people_who_come_close_are_solved_again(short_pair: Path, tmp_path: Path, monkeypatch, capsys) -> None:
    from solver_backend.fitters import other_skin, pipeline

    given: list[list[str]] = []
    solve = pipeline.solve

    def noting(capture, *args, others=(), **options):
        given.append([other.provenance["person"] for other in others])
        return solve(capture, *args, others=others, **options)

    monkeypatch.setattr(pipeline, "solve", noting)
    monkeypatch.setattr(other_skin, "CLOSE_M", 2.0)
    jobs: list[str] = []
    for name in ("Person 1", "Person 2"):
        job = tmp_path / f"{name[-1]}.json"
        job.write_text(json.dumps({"version": 1, "capture": str(short_pair), "out": f"{name[-1]}.npz", "person": name}))
        jobs += ["--job", str(job)]
    assert main(["solve", *jobs, "--json"]) == 0
    assert given == [[], [], ["Person 2"], ["Person 1"]]
    result = last_event(capsys)
    assert len(result["takes"]) == 2 and not result["failed"]
    assert [read_motion(take["motion"]).provenance["person"] for take in result["takes"]] == ["Person 1", "Person 2"]


@pytest.mark.slow
def test_everybody_whom_a_single_camera_sees_is_solved(short_pair: Path, tmp_path: Path, capsys) -> None:
    whole = read_capture(short_pair)
    one = write_capture(tmp_path / "one.npz", whole.views([0]))
    quick = ["--person", "all", "--iterations", "2", "--json"]
    assert main(["solve", str(one), "--out", str(tmp_path / "take.npz"), *quick]) == 0
    result = last_event(capsys)
    assert not result["failed"] and [take["person"] for take in result["takes"]][:2] == ["Person 1", "Person 2"]
    motions = [read_motion(take["motion"]) for take in result["takes"][:2]]
    for motion in motions:
        assert "one_camera" in {item["code"] for item in motion.provenance["diagnostics"]}
    apart = np.linalg.norm(motions[0].transl[:, :2] - motions[1].transl[:, :2], axis=-1)
    assert apart.min() > 0.5


@pytest.mark.slow
def test_one_who_fails_does_not_stop_the_others(short_pair: Path, tmp_path: Path, capsys) -> None:
    from dataclasses import replace

    whole = read_capture(short_pair)
    nobody = replace(whole.people[1].keypoints, confidence=np.zeros_like(whole.people[1].keypoints.confidence))
    people = (whole.people[0], replace(whole.people[1], keypoints=nobody))
    broken = write_capture(tmp_path / "broken.npz", replace(whole, people=people))
    assert main(["solve", str(broken), "--out", str(tmp_path / "t.npz"), "--person", "all", "--json"]) == 0
    result = last_event(capsys)
    assert [t["person"] for t in result["takes"]] == ["Person 1"]
    assert result["failed"][0]["name"].endswith("Person 2") and result["failed"][0]["code"] == "no_detections"
    # What is there is refused before anything is solved, for everybody.
    assert main(["solve", str(broken), "--out", str(tmp_path / "t.npz"), "--person", "all", "--json"]) != 0
    assert last_event(capsys)["code"] == "output_exists"


@pytest.mark.slow
def test_a_session_is_one_batch(shared_data: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / "session"
    quick = ["--person", "all", "--iterations", "2", "--json"]
    assert main(["solve", str(shared_data / SESSION), "--out", str(out), *quick]) == 0
    result = last_event(capsys)
    assert len(result["takes"]) == 5 and not result["failed"]
    assert sorted(p.name for p in out.iterdir())[0] == "S00_P01_T00_StaticTrialParticipant1.npz"
    assert main(["solve", str(shared_data / SESSION), "--out", str(tmp_path / "one.npz"), "--json"]) == 2


@pytest.mark.slow
def test_each_trial_of_a_session_becomes_a_capture(shared_data: Path, tmp_path: Path, capsys) -> None:
    assert main(["convert", str(shared_data / SESSION), "--out", str(tmp_path / "all"), "--json"]) == 0
    captures = last_event(capsys)["captures"]
    assert [c["frames"] for c in captures] == [12, 12, 100] and [len(c["people"]) for c in captures] == [0, 0, 3]
    assert all(Path(c["capture"]).is_file() for c in captures)


@pytest.mark.slow
def test_jobs_are_solved_one_after_another(short_pair: Path, tmp_path: Path, capsys) -> None:
    jobs = []
    for name in ("1", "2"):
        path = tmp_path / f"job{name}.json"
        job = {"version": 1, "capture": str(short_pair), "out": f"{name}.npz", "person": name}
        path.write_text(json.dumps(job | {"settings": {"iterations": 2}}))
        jobs += ["--job", str(path)]
    assert main(["solve", *jobs, "--json"]) == 0
    assert [t["person"] for t in last_event(capsys)["takes"]] == ["Person 1", "Person 2"]
