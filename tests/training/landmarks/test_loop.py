"""A training that was broken off goes on; tables of poses keep what they hold; tail poses are what they are called."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from solver_backend.body.body import load_body  # noqa: E402
from solver_backend.exchange.errors import FileMissing, JobInvalid, NonFiniteData, TrainingMismatch  # noqa: E402
from solver_backend.geometry.rotations import exp_so3  # noqa: E402
from training.data.sources.clips import Clip  # noqa: E402
from training.landmarks.cloud_stream import CloudStream  # noqa: E402
from training.landmarks.loop import LandmarkTraining, train_landmarks  # noqa: E402
from training.landmarks.models import (  # noqa: E402
    Ours,
    PointNetWidths,
)
from training.landmarks.poses import (  # noqa: E402
    FADES,
    GROUPS,
    Balance,
    PoseTable,
    drawer,
    groups_of,
    on_the_floor,
    relevance_of,
)
from training.landmarks.rows import Row, named_rows, train_row  # noqa: E402
from training.landmarks.train import TABLES, table_of  # noqa: E402


@pytest.fixture(scope="module")
def table() -> PoseTable:
    rng = np.random.default_rng(0)
    arrays = {name: 0.3 * rng.normal(size=(12, 22, 3)) for name in ("training", "ordinary", "tail", "floor", "squad")}
    return PoseTable({
        **{name: value.astype(np.float16) for name, value in arrays.items()},
        "mahalanobis": np.linspace(2, 9, 12, dtype=np.float32),
        "reconstruction": np.linspace(0, 1, 12, dtype=np.float32),
    })  # fmt: skip


@pytest.fixture(scope="module")
def draw(table):
    return drawer(CloudStream(load_body(), "cpu"), table, 8, Balance("σ(D)", "squad"))


def settings(steps: int, **more) -> LandmarkTraining:
    return LandmarkTraining(steps=steps, batch=8, checkpoint_s=0.0, **more)


def test_a_training_goes_on_from_its_checkpoint(tmp_path, draw):
    torch.manual_seed(0)
    seen: list[int] = []
    model = Ours(PointNetWidths(16, 1, 2))
    train_landmarks(model, draw, settings(3), tmp_path, lambda m, s, n: seen.append(n))
    before = {k: v.clone() for k, v in model.state_dict().items()}
    again = Ours(PointNetWidths(16, 1, 2))
    averaged = train_landmarks(again, draw, settings(5), tmp_path, lambda m, s, n: seen.append(n))
    assert seen == [3, 5]  # steps are looked at by tens
    assert any(not torch.equal(before[k], v) for k, v in again.state_dict().items())
    assert averaged is not again
    with pytest.raises(TrainingMismatch, match="seed"):
        train_landmarks(Ours(PointNetWidths(16, 1, 2)), draw, settings(6, seed=1), tmp_path, lambda *_: None)
    with pytest.raises(TrainingMismatch, match="another network"):
        train_landmarks(Ours(PointNetWidths(32, 1, 2)), draw, settings(6), tmp_path, lambda *_: None)


def test_the_checkpoint_of_another_row_is_refused_by_its_name(tmp_path, table):
    rows = named_rows(2, resolution=32)
    body, work = load_body(), tmp_path / "base"
    train_row(rows["base"], table, body, settings(1), work)
    with pytest.raises(TrainingMismatch, match=r"of row 'base', not of 'squad'.*--from"):
        train_row(rows["squad"], table, body, settings(2), work)
    with pytest.raises(TrainingMismatch, match=r"row 'base'.*other resolution"):
        train_row(named_rows(2, resolution=48)["base"], table, body, settings(2), work)
    kept = (work / "checkpoint.pt").read_bytes()
    assert train_row(rows["squad"], table, body, settings(2), tmp_path / "squad", work / "checkpoint.pt")["steps"] == 2
    assert kept == (work / "checkpoint.pt").read_bytes()
    assert train_row(rows["base"], table, body, settings(2), work)["steps"] == 2


def test_numbers_that_are_none_end_a_training_by_name_and_leave_the_checkpoint(tmp_path, draw, table):
    def network() -> Ours:
        torch.manual_seed(0)
        return Ours(PointNetWidths(16, 1, 2))

    train_landmarks(network(), draw, settings(2), tmp_path, lambda *_: None)
    kept, seen = (tmp_path / "checkpoint.pt").read_bytes(), []

    def spoiled(done):
        clouds = draw(done)
        clouds.targets[:] = float("nan")
        return clouds

    with pytest.raises(NonFiniteData, match=r"loss is not a number .*step .*learning rate"):
        train_landmarks(network(), spoiled, settings(30), tmp_path, lambda m, s, n: seen.append(n))
    assert not seen and (tmp_path / "checkpoint.pt").read_bytes() == kept
    arrays = {**table.arrays, "tail": np.full((12, 22, 3), np.nan, np.float16)}
    with pytest.raises(NonFiniteData, match=r"12 of 12 tail poses"):
        train_row(Row("coordinates", 8), PoseTable(arrays), load_body(), settings(2), tmp_path / "row")


def test_rows_go_on_from_one_checkpoint(tmp_path, draw):
    def network() -> Ours:
        torch.manual_seed(0)
        return Ours(PointNetWidths(16, 1, 2))

    first, seen = tmp_path / "first", []
    train_landmarks(network(), draw, settings(3), first, lambda *_: None)
    checkpoint = first / "checkpoint.pt"
    kept = checkpoint.read_bytes()
    other = network()
    train_landmarks(other, draw, settings(4, seed=1), tmp_path / "b", lambda m, s, n: seen.append(n), checkpoint)
    assert seen == [4] and checkpoint.read_bytes() == kept
    started = torch.load(checkpoint, weights_only=True)["model"]
    assert all(torch.allclose(started[k], v, atol=1e-3) for k, v in other.state_dict().items())  # one small step away
    # What the folder has comes first.
    train_landmarks(network(), draw, settings(6, seed=1), tmp_path / "b", lambda m, s, n: seen.append(n), checkpoint)
    assert seen == [4, 6]
    with pytest.raises(FileMissing, match="no such checkpoint"):
        train_landmarks(network(), draw, settings(4), tmp_path / "c", lambda *_: None, tmp_path / "none.pt")


def test_seconds_may_be_the_processors(tmp_path, draw, monkeypatch):
    from training.landmarks import loop

    spent = iter(np.arange(0.0, 1e6, 0.5))
    monkeypatch.setattr(loop.time, "process_time", lambda: float(next(spent)))
    monkeypatch.setattr(loop.time, "monotonic", lambda: 0.0)
    seen: list[tuple[float, int]] = []
    timed = LandmarkTraining(seconds=30.0, processor=True, batch=8, judged=2)
    torch.manual_seed(0)
    train_landmarks(Ours(PointNetWidths(16, 1, 2)), draw, timed, tmp_path, lambda m, s, n: seen.append((s, n)))
    assert len(seen) == 2 and 15.0 <= seen[0][0] < 25.0 and seen[1][0] >= 30.0


def test_maps_that_no_unet_can_halve_are_refused():
    with pytest.raises(JobInvalid, match="multiple of 16 pixels wide, not 100"):
        named_rows(8, resolution=100)
    assert named_rows(8, resolution=48)["democap"].model().size == 48


def test_a_row_writes_weights_and_figures(tmp_path, table):
    row = named_rows(2)["ours"]
    assert isinstance(row, Row) and row.balance == Balance("σ(D)", "squad")
    best = train_row(Row("coordinates", 8), table, load_body(), settings(2), tmp_path)
    assert best["steps"] == 2 and {"fixed ordinary", "fixed tail", "fixed floor"} <= set(best)
    assert (tmp_path / "weights.npz").is_file() and (tmp_path / "figures.json").is_file()


def test_rarer_poses_weigh_more_and_relevance_is_clamped_as_published(table):
    for kind, least, most in (("σ(D)", 1, 2), ("e(D)", 1, 3), ("σ(R)", 1, 2), ("e(R)", 1, 3)):
        weight = relevance_of(table, kind)
        assert (np.diff(weight) >= 0).all() and weight.min() >= least and weight.max() <= most


def test_what_is_blended_comes_on_top_and_gives_way_where_balance_fades(table):
    stream = CloudStream(load_body(), "cpu")

    def weights(balance: Balance, done: float) -> np.ndarray:
        return drawer(stream, table, 8, balance)(torch.tensor(done)).weight.numpy()

    stays, fades = Balance("σ(D)", "squad"), Balance("σ(D)", "squad", fades=True)
    assert weights(Balance(), 0.0).tolist() == [1.0] * 8
    assert weights(Balance(sampler="squad", blended=0.5), 0.0).tolist() == [1.0] * 12
    for balance, done in ((stays, 0.0), (stays, 1.0), (fades, 0.3)):
        drawn = weights(balance, done)
        assert len(drawn) == 10 and (drawn > 1.1).all() and (drawn[8:] > 0.99 * drawn.max()).all()
    halfway = weights(fades, 0.5 * (FADES[0] + FADES[1]))
    assert len(halfway) == 10 and (halfway[:8] > 1.05).all() and (halfway[8:] < 0.8).all()
    assert weights(fades, FADES[1]).tolist() == [1.0] * 8


def test_a_table_keeps_its_poses(tmp_path, table):
    table.write(tmp_path / "poses.npz")
    assert np.array_equal(PoseTable.read(tmp_path / "poses.npz").poses("tail"), table.poses("tail"))


def test_each_autoencoder_has_a_table_of_its_own(tmp_path, table):
    table.write(tmp_path / TABLES["rvposer"])
    PoseTable({"training": table.arrays["training"][:5]}).write(tmp_path / TABLES["vposer"])
    assert len(table_of(tmp_path, tmp_path).poses("training")) == 12
    assert len(table_of(tmp_path, tmp_path, "vposer").poses("training")) == 5
    assert len(table_of(tmp_path / TABLES["vposer"], tmp_path, "rvposer").poses("training")) == 5


def posed(**joints: tuple[float, float, float]) -> np.ndarray:
    from solver_backend.exchange.joint_sets import SMPL_JOINTS

    rotvec = np.zeros((1, 22, 3))
    for name, value in joints.items():
        rotvec[0, SMPL_JOINTS.index(name)] = value
    return exp_so3(rotvec)


def test_poses_are_of_their_groups():
    stand = posed()
    assert not groups_of(stand).any() and not on_the_floor(stand).any()
    kick = posed(left_hip=(-1.6, 0, 0))
    assert groups_of(kick)[0].tolist() == [name == "kicks" for name in GROUPS]
    crouch = posed(left_hip=(-2.0, 0, 0), right_hip=(-2.0, 0, 0), left_knee=(2.3, 0, 0), right_knee=(2.3, 0, 0))
    assert groups_of(crouch)[0, GROUPS.index("crouching")]
    legs = posed(left_hip=(0, 0, -0.35), right_hip=(0, 0, 0.35))
    assert groups_of(legs)[0, GROUPS.index("crossed legs")]
    assert on_the_floor(posed(pelvis=(1.5, 0, 0))).all()


def test_clips_keep_the_pelvis_only_where_it_was_recorded():
    assert Clip("ui_prmd/x", "s", np.zeros((3, 21, 3, 3), np.float32)).root is None
