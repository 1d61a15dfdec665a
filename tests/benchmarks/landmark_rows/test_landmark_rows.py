"""Test tables and pictures of trained rows on figures and poses with known answers."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from PIL import Image  # noqa: E402

from solver_backend.body.body import load_body  # noqa: E402
from solver_backend.geometry.rotations import exp_so3  # noqa: E402
from solver_backend.labelling.outputs import LANDMARKS  # noqa: E402
from tests.benchmarks import bench_landmark_rows, bench_landmark_sources  # noqa: E402
from tests.benchmarks.landmark_rows import train_rows, train_sources  # noqa: E402
from tests.benchmarks.landmark_rows.row_folders import folder_of, trained  # noqa: E402
from tests.benchmarks.landmark_rows.row_tables import PCK_LIMITS_CM, read_figures, row_tables  # noqa: E402
from tests.benchmarks.landmark_rows.tail_pictures import (  # noqa: E402
    ANSWER,
    APART,
    CELL,
    TRUTH,
    draw_tail,
    landmarks,
    representative,
)
from tests.benchmarks.metric import BenchmarkSkipped, key_of  # noqa: E402
from training.data.sources.clips import Clip  # noqa: E402
from training.landmarks.cloud_stream import CloudStream  # noqa: E402
from training.landmarks.loop import LandmarkTraining  # noqa: E402
from training.landmarks.onnx_export import trained_model  # noqa: E402
from training.landmarks.poses import PoseTable  # noqa: E402
from training.landmarks.rows import FIXED, LIMBS, SETS, Row, evaluate, evaluation_poses, train_row  # noqa: E402  # noqa: E402


def figures(rmse: float) -> dict:
    pck = {f"pck{cm}_{limb}": 10.0 * cm for cm in PCK_LIMITS_CM for limb in LIMBS}
    row = {"rmse_mm": rmse, "mpjpe_mm": rmse / 2, **pck}
    return {"chosen": {f"{kind} {where}": row for kind in ("fixed", "thesis") for where in SETS}}


def test_ratios_are_to_the_first_row(tmp_path):
    for name, rmse in (("base", 80.0), ("ortho", 60.0)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "figures.json").write_text(json.dumps(figures(rmse)))
    text = row_tables(read_figures({name: tmp_path / name for name in ("base", "ortho")}), "base")
    assert text.count("###") == 3 and "| base | 80.0 | 1.000 | 40.0 | 1.000 | 10.0 |" in text
    assert "| ortho | 60.0 | 0.750 | 30.0 | 0.750 | 10.0 | 10.0 | 10.0 | 30.0 |" in text


def test_a_trained_row_is_read_back_as_it_was_judged(tmp_path):
    rng = np.random.default_rng(0)
    poses = {name: 0.3 * rng.normal(size=(6, 22, 3)) for name in ("training", *SETS)}
    table = PoseTable({name: pose.astype(np.float16) for name, pose in poses.items()})
    row = Row("published", 2, variety=FIXED, resolution=32)
    settings = LandmarkTraining(steps=2, batch=4, judged=1)
    best = train_row(row, table, load_body(), settings, tmp_path)
    model = trained_model(read_figures({"row": tmp_path})["row"], tmp_path / "weights.npz")
    torch.manual_seed(1234)
    stream = CloudStream(load_body(), "cpu", FIXED)
    clouds = {name: stream.draw(pose) for name, pose in evaluation_poses(table).items()}
    assert evaluate(model, [clouds["tail"]])["rmse_mm"] == pytest.approx(best["fixed tail"]["rmse_mm"], rel=2e-3)
    told = landmarks(model, clouds["tail"])
    assert told.shape == (6, len(LANDMARKS), 3) and np.isnan(told).any(axis=(0, 2)).sum() == 6


def test_shown_are_the_median_and_the_ninth_tenth_of_each_group():
    error, groups = np.array([5.0, 1, 4, 2, 3, 9, 7, 8]), np.array([0, 0, 0, 0, 0, 1, 1, 1])
    assert representative(error, groups) == [4, 0, 7, 5]


def test_what_is_apart_is_drawn_and_what_agrees_is_not(tmp_path):
    torch.manual_seed(0)
    truth = CloudStream(load_body(), "cpu", FIXED).draw(torch.zeros(1, 22, 3)).targets.numpy()
    off = truth + np.array([0.15, 0.0, 0.0])
    draw_tail(tmp_path / "tail.png", truth, [truth[0, :53]], ["standing"], {"right": truth, "off": off})
    picture = np.asarray(Image.open(tmp_path / "tail.png")).astype(int)
    assert picture.shape == (24 + 3 * CELL[1], 100 + CELL[0], 3)
    cloud, right, wrong = (picture[24 + i * CELL[1] : 24 + (i + 1) * CELL[1], 100:] for i in range(3))

    def of(cell: np.ndarray, colour: tuple[int, int, int]) -> int:
        return int((np.abs(cell - colour).sum(-1) < 12).sum())

    assert of(cloud, TRUTH) > 50 and not of(cloud, ANSWER)
    assert of(right, ANSWER) > 50 and not of(right, APART)
    assert of(wrong, APART) > 20 and of(wrong, TRUTH) > 20 > of(right, TRUTH)


def test_rows_are_trained_once_and_their_medians_are_the_benchmarks(tmp_path, capsys):
    rng = np.random.default_rng(0)
    poses = {name: 0.3 * rng.normal(size=(6, 22, 3)) for name in ("training", *SETS)}
    data, root = tmp_path / "poses.npz", tmp_path / "rows"
    PoseTable({name: pose.astype(np.float16) for name, pose in poses.items()}).write(data)
    with pytest.raises(BenchmarkSkipped, match="train_rows"):
        bench_landmark_rows.run(root)
    order = ["--data", str(data), "--out", str(root), "--rows", "bmse", "--steps", "1", "--batch", "2", "--seeds"]
    assert train_rows.main([*order, "1"]) == 0 and "bmse, seed 1" in capsys.readouterr().out
    assert train_rows.main([*order, "1", "2"]) == 0
    assert "seed 1" not in capsys.readouterr().out and set(trained(root)) == {("bmse", 1), ("bmse", 2)}
    found = {metric.key: metric.value for metric in bench_landmark_rows.run(root)}
    seeds = [json.loads((root / f"bmse_{seed}" / "figures.json").read_text())["chosen"] for seed in (1, 2)]
    assert found["seeds"] == 2
    assert found["bmse_tail_rmse_mm"] == pytest.approx(np.mean([seed["fixed tail"]["rmse_mm"] for seed in seeds]))
    share = np.mean([seed["thesis floor"]["pck7_all"] for seed in seeds])
    assert found["bmse_thesis_floor_pck7_percent"] == pytest.approx(share)


def test_sources_are_evened_and_evaluated_on_the_same_poses(tmp_path):
    rng = np.random.default_rng(0)

    def clip(subject: str, name: str, frames: int) -> Clip:
        turns = exp_so3(0.3 * rng.normal(size=(frames, 22, 3))).astype(np.float32)
        return Clip(f"mb2/{name}", subject, turns[:, 1:], turns[:, 0])

    clips = [clip("16", "16_01", 150), clip("49", "49_01", 100), clip("08", "08_01", 40)]
    tables = train_sources.evened(clips, [])
    few = tables["two people"].arrays
    (count,) = {len(table.arrays["training"]) for table in tables.values()}
    assert 140 < count < 150  # the rarest 3 % are anchors
    for name in SETS:
        np.testing.assert_array_equal(few[name], tables["many people"].arrays[name])
    for source, seed in itertools.product(train_sources.SOURCES, (1, 2)):
        folder = folder_of(tmp_path, source, seed)
        folder.mkdir()
        error = figures(50.0 + seed + 10 * (source == "two people"))
        (folder / "figures.json").write_text(json.dumps(error))
    found = {metric.key: metric.value for metric in bench_landmark_sources.run(tmp_path)}
    assert (found["two_people_tail_rmse_mm"], found["many_people_tail_rmse_mm"], found["seeds"]) == (61.5, 51.5, 2)
    assert 0 < found["spread_many_people_tail"] < 0.02


def test_the_folder_of_a_row_gives_its_name_back(tmp_path):
    for row in train_rows.ROWS:
        folder = folder_of(tmp_path, row, 3)
        folder.mkdir(parents=True)
        (folder / "figures.json").write_text("{}")
    assert set(trained(tmp_path)) == {(row, 3) for row in train_rows.ROWS}
    assert len({key_of(row) for row in train_rows.ROWS}) == len(train_rows.ROWS)
