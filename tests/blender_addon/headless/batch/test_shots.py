"""Shots of a data set made by several workers: the same bytes as by one, whoever dies on the way."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import threading
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from blender_addon._exchange.progress import silent
from blender_addon.errors import ShotsMissing
from blender_addon.headless.batch import run_batch
from blender_addon.headless.batch.engines.cluster_task import work_of
from blender_addon.headless.batch.record import read_record
from blender_addon.headless.batch.shots import RECORDS, SHOTS, Shots, digest_of, require_all
from blender_addon.headless.studio import run_studio
from blender_addon.headless.verb_table import VERBS
from solver_backend.synthesis.studio.data_set import make_data_set
from solver_backend.synthesis.studio.spec import spec_of

SPEC: dict[str, Any] = {
    "film": ["masks"], "camera_arrays": [{"preset": "webcam_ring_4", "scale": 0.1}], "frames": 2, "fps": 4,
    "people": {"count": 3}, "seed": 5,
}  # fmt: skip


def digests(folder: Path) -> dict[str, str]:
    files = (path for path in sorted((folder / SHOTS).rglob("*")) if path.is_file())
    return {p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("plain")
    make_data_set(spec_of(SPEC), out)
    return out


def asked(folder: Path, **change: Any) -> tuple[Path, Path]:
    spec = folder / "spec ü.json"
    spec.write_text(json.dumps(SPEC | change))
    return spec, folder / "set"


def test_steps_have_keys_of_description_name_and_version_and_travel(tmp_path: Path) -> None:
    spec, out = asked(tmp_path)
    work = Shots(spec, out, digest_of(spec), colour=True)
    item, other = work.item("a"), work.item("b")
    steps = work.steps(item)
    assert [step.name for step in steps] == ["film", "colour"]
    again = work_of(json.loads(json.dumps(work.plain())))
    assert again == work and again.steps(item) == steps
    assert not {step.key for step in steps} & {step.key for step in work.steps(other)}
    spec.write_text(json.dumps(SPEC | {"seed": 6}))
    changed = Shots(spec, out, digest_of(spec), colour=True)
    assert not {step.key for step in steps} & {step.key for step in changed.steps(item)}
    assert not again.sees(item), "the data set's folder is not there yet"


def test_shots_that_are_missing_are_named_with_their_reason(tmp_path: Path) -> None:
    done = {"take": "a", "status": "done"}
    failed = {"take": "b", "status": "failed", "error": {"message": "Nobody is seen."}}
    require_all([done], tmp_path)
    with pytest.raises(ShotsMissing, match=r"1 of 2 shots failed: b: Nobody is seen"):
        require_all([done, failed], tmp_path)


@pytest.mark.slow
def test_processes_make_the_same_bytes_and_do_again_what_is_gone(
    plain: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_batch, "find_spec", lambda name: None)
    spec, out = asked(tmp_path)
    request = VERBS["dataset make"].arguments(description=spec, out=out, workers=2)
    run_studio(request, silent)
    assert digests(out) == digests(plain)
    assert {path.name for path in out.iterdir()} >= {"card.md", RECORDS, SHOTS, "studio.json"}
    first, *others = sorted((out / SHOTS).iterdir())
    (first / "shot.json").unlink()
    kept = {path: path.stat().st_mtime_ns for path in others}
    run_studio(request, silent)
    assert digests(out) == digests(plain)
    assert {path: path.stat().st_mtime_ns for path in others} == kept


@pytest.mark.slow
def test_one_shot_that_cannot_be_made_does_not_stop_the_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_batch, "find_spec", lambda name: None)
    spec, out = asked(tmp_path)
    name = "choreography-person001-webcam_ring_4-suit"
    (out / RECORDS / name).mkdir(parents=True)
    (out / RECORDS / name / "mine.txt").write_text("somebody else's")
    (out / "studio.json").write_text("{}")
    claim = [
        sys.executable,
        "-m",
        "solver_backend",
        "dataset make",
        str(spec),
        "--out",
        str(tmp_path / "other"),
        "--claim",
    ]
    subprocess.run(claim, check=True, capture_output=True)
    (out / "studio.json").write_bytes((tmp_path / "other" / "studio.json").read_bytes())
    with pytest.raises(ShotsMissing, match=name):
        run_studio(VERBS["dataset make"].arguments(description=spec, out=out, workers=2), silent)
    assert sum((folder / "shot.json").is_file() for folder in (out / SHOTS).iterdir()) == 2


@pytest.mark.slow
@pytest.mark.skipif(find_spec("distributed") is None, reason="Dask is not installed")
def test_a_cluster_makes_the_same_bytes_though_a_worker_dies(plain: Path, tmp_path: Path) -> None:
    from tests.support.tended_cluster import Tended

    spec, out = asked(tmp_path)
    (tmp_path / "dask").mkdir()
    cluster = Tended(2, tmp_path / "dask")

    def kill() -> None:
        while not list((out / RECORDS).glob("choreography*")):
            time.sleep(0.05)
        cluster.kill(1)

    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    try:
        result: Any = run_studio(
            VERBS["dataset make"].arguments(description=spec, out=out, scheduler=cluster.address), silent
        )
    finally:
        cluster.close()
    killer.join()
    assert result["frames"] == 6
    assert digests(out) == digests(plain), "nothing half-made is left among the shots"
    records = [read_record(folder) or {} for folder in (out / RECORDS).glob("choreography*")]
    ends = [[attempt["how"] for attempt in record["attempts"]].count("done") for record in records]
    assert [record["status"] for record in records] == ["done"] * 3 and ends == [1, 1, 1]


@pytest.mark.slow
@pytest.mark.skipif(find_spec("distributed") is None, reason="Dask is not installed")
def test_colour_by_a_clusters_workers_is_that_of_one_process(tmp_path: Path) -> None:
    from tests.support.tended_cluster import Tended

    small = {"film": ["rgb"], "looks": ["varied"], "people": {"count": 2}, "frames": 1}
    for part in ("one", "many"):
        (tmp_path / part).mkdir()
    (tmp_path / "dask").mkdir()
    spec, one = asked(tmp_path / "one", **small)
    run_studio(VERBS["dataset make"].arguments(description=spec, out=one), silent)
    spec, many = asked(tmp_path / "many", **small)
    cluster = Tended(2, tmp_path / "dask")
    try:
        run_studio(VERBS["dataset make"].arguments(description=spec, out=many, scheduler=cluster.address), silent)
    finally:
        cluster.close()
    assert digests(many) == digests(one)
    assert sum(name.endswith(".png") for name in digests(many)) == 2 * 4
    steps = [(read_record(folder) or {})["steps"] for folder in (many / RECORDS).glob("choreography*")]
    assert [sorted(step) for step in steps] == [["colour", "film"]] * 2
    assert (many / "contact_sheet.png").read_bytes() == (one / "contact_sheet.png").read_bytes()
