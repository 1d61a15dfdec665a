"""Models that a description explains: each decoding, other layouts, and descriptions that are wrong."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from solver_backend.exchange.errors import FileDamaged
from solver_backend.videos.detect.child.pose_workers import described_pose
from solver_backend.videos.detect.child.pose_workers.described_pose import (
    DEFAULTS,
    REQUIRED,
    DescribedPose,
    heat_peaks,
    read_description,
)
from solver_backend.videos.detect.child.pose_workers.serve import Refused
from solver_backend.videos.detect.detector import (
    DetectorMissing,
    DetectorOutputsUnknown,
    DetectorProcess,
    chosen_detector,
)
from tests.support.fake_litert import FakeModel, install
from tests.support.pose_models import KEYPOINTS, write_heatmaps, write_movenet, write_rtmpose
from tests.support.videos import dots

PLACES = np.array([[60.0, 40.0], [240.0, 90.0], [150.0, 180.0]])
SIZE = (320, 220)
IMAGENET = {"mean": [123.675, 116.28, 103.53], "std": [58.395, 57.12, 57.375]}


def described(model: Path, **fields: Any) -> Path:
    path = model.with_suffix(".json")
    path.write_text(json.dumps({"model": model.name, "joint_set": "COCO_17", **fields}))
    return path


def people_in(path: Path) -> list[np.ndarray]:
    with DetectorProcess(chosen_detector(str(path))) as process:
        return [process.detect(dots(PLACES + move, SIZE), 0.0)["keypoints"] for move in (0.0, 3.0)]


def test_a_description_of_rtmpose_says_what_the_program_recognises_itself(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    model = write_rtmpose(tmp_path / "own.onnx")
    known = people_in(model)
    found = people_in(described(model, size=[96, 128], decoding="simcc", outputs=["simcc_x", "simcc_y"], **IMAGENET))
    np.testing.assert_array_equal(found, known)


@pytest.mark.parametrize("channels", ["RGB", "BGR"])
def test_heat_maps_show_the_brightest_points(tmp_path: Path, channels: str) -> None:
    pytest.importorskip("onnxruntime")
    model = write_heatmaps(tmp_path / "heat.onnx")
    order = [0, 1, 2] if channels == "RGB" else [2, 1, 0]
    found = people_in(described(model, size=[96, 128], decoding="heatmaps", channels=channels))
    for move, people in zip((0.0, 3.0), found, strict=True):
        assert people.shape == (1, KEYPOINTS, 3) and (people[..., 2] > 0.9).all()
        np.testing.assert_allclose(people[0, order, :2], PLACES + move, atol=4.0)


def test_coordinates_have_the_columns_and_the_unit_that_are_described(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    fields = {"columns": ["y", "x", "score"], "unit": "shares", "mean": [0, 0, 0], "std": [1, 1, 1]}
    model = write_movenet(tmp_path / "movenet.onnx", side=160)
    first, second = people_in(described(model, size=[160, 160], decoding="coordinates", **fields))
    np.testing.assert_allclose(first[0, :3, :2], PLACES, atol=4.0)
    np.testing.assert_allclose(second[0, :3, :2], PLACES + 3.0, atol=4.0)
    np.testing.assert_allclose(first[0, :, 2], 0.9, atol=1e-6)


def test_a_litert_model_gives_logits_and_other_columns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def answer(picture: np.ndarray) -> list[np.ndarray]:
        assert picture.max() <= 1.0, "levels are divided by 255"
        return [np.array([[64.0 + k, 32.0, 9.0, 2.0, 0.0] for k in range(33)])]

    install(monkeypatch, {b"own": FakeModel("own", (128, 64, 3), answer, [(33 * 5,)])})
    (tmp_path / "own.tflite").write_bytes(b"own")
    fields = {"size": [64, 128], "decoding": "coordinates", "score": "logit"}
    fields |= {"columns": ["x", "y", "z", "score", "presence"], "joint_set": "MEDIAPIPE_33"}
    choice = chosen_detector(str(described(tmp_path / "own.tflite", **fields)))
    [person] = DescribedPose(choice.options).detect(np.full((128, 64, 3), 255, np.uint8), 0.0)["keypoints"]
    assert person.shape == (33, 3) and person[0, 2] == pytest.approx(1 / (1 + np.exp(-2.0)))


@pytest.mark.parametrize("udp", [False, True])
def test_a_peak_of_gaussian_heat_is_found_between_cells(udp: bool) -> None:
    rng = np.random.default_rng(3)
    cells, size = np.array([48, 64]), np.array([192, 256])
    at = rng.uniform(4, 40, (20, 2))
    x, y = np.arange(cells[0]), np.arange(cells[1])[:, None]
    heat = np.stack([np.exp(-((x - a) ** 2 + (y - b) ** 2) / 8.0) for a, b in at])
    found = heat_peaks(heat, tuple(size), udp=udp)
    scale = (size - 1) / (cells - 1) if udp else size / cells
    np.testing.assert_allclose(found[:, :2], at * scale, atol=1e-6)
    flat = heat_peaks(np.zeros((2, 8, 6)), (48, 64), udp=udp)
    assert np.isfinite(flat).all() and (flat[:, 2] == 0).all()


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"size": None}, "no 'size'"), ({"sise": 3}, "unknown field 'sise'"), ({"size": [192]}, "'size' is"),
        ({"size": [True, 64]}, "'size' is"), ({"decoding": "regression"}, "one of heatmaps, simcc, coordinates"),
        ({"std": [1, 0, 1]}, "'std' is"), ({"mean": [1, 2, float("nan")]}, "'mean' is"),
        ({"mean": [10**400, 0, 0]}, "'mean' is"),
        ({"padding": "wide"}, "'padding' is"), ({"columns": ["y", "score"]}, "'columns' is"),
        ({"outputs": "heat"}, "'outputs' is"), ({"channels": ["RGB"]}, "'channels' is"), ({"udp": 2}, "'udp' is"),
    ],
)  # fmt: skip
def test_the_wrong_field_is_named(fields: dict[str, Any], words: str) -> None:
    sound = {"model": "a.onnx", "joint_set": "COCO_17", "size": [192, 256], "decoding": "heatmaps"}
    assert set(read_description(sound)) == {*REQUIRED, *DEFAULTS}
    changed = {name: value for name, value in {**sound, **fields}.items() if value is not None}
    with pytest.raises(Refused) as refused:
        read_description(changed)
    assert words in refused.value.message and refused.value.hint


def test_a_model_that_the_description_does_not_fit_is_named_with_its_outputs(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    model = write_rtmpose(tmp_path / "own.onnx")
    for fields, words in (
        ({"decoding": "simcc", "outputs": ["x", "simcc_y"]}, "need 2 of the model's outputs.*simcc_x"),
        ({"decoding": "heatmaps"}, "do not match the description"),
        ({"decoding": "simcc", "size": [64, 64]}, r"input \[1, 3, 128, 96\] and outputs"),
    ):
        path = described(model, **{"size": [96, 128], **fields})
        with pytest.raises(DetectorOutputsUnknown, match=words):
            people_in(path)


def with_outputs(
    monkeypatch: pytest.MonkeyPatch, given: list[int], answers: list[np.ndarray], **fields: Any
) -> DescribedPose:
    """Return a model with an input of this shape and these answers."""
    told = [(f"out{i}", list(answer.shape)) for i, answer in enumerate(answers)]
    monkeypatch.setattr(described_pose, "_onnx", lambda path: (given, "tensor(float)", told, lambda tensor: answers))
    description = {"model": "own.onnx", "joint_set": "COCO_17", "size": [96, 128], **fields}
    return DescribedPose({"description": description, "model": "own.onnx", "counts": [17]})


PICTURE = np.zeros((128, 96, 3), np.float32)


def test_a_logit_of_simcc_is_no_sure_point(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [np.full((1, 17, count), -4.0) for count in (192, 256)]
    model = with_outputs(monkeypatch, [1, 3, 128, 96], rows, decoding="simcc", score="logit")
    np.testing.assert_allclose(model.points(PICTURE)[:, 2], 1.0 / (1.0 + np.exp(4.0)))
    assert len(model.people(np.zeros((200, 200, 3), np.uint8))) == 0, "nobody is in an empty picture"


@pytest.mark.parametrize("udp", [False, True])
def test_a_point_of_the_whole_picture_is_found_in_its_heat_map(monkeypatch: pytest.MonkeyPatch, *, udp: bool) -> None:
    """Without UDP cell i is at pixel 4 i, and with UDP the outer cells are at the outer pixels (codecs of MMPose)."""
    at = np.array([95.0, 127.0]) if udp else np.array([92.0, 124.0])
    x, y = np.arange(24), np.arange(32)[:, None]
    near = np.array([23.0, 31.0])
    for place, cell in ((at, near), (0.0 * at, 0.0 * near), (0.5 * at, 0.5 * near)):
        heat = np.exp(-((x - cell[0]) ** 2 + (y - cell[1]) ** 2) / 8.0)
        model = with_outputs(monkeypatch, [1, 3, 128, 96], [np.tile(heat, (1, 17, 1, 1))], decoding="heatmaps", udp=udp)
        np.testing.assert_allclose(model.points(PICTURE)[0, :2], place, atol=0.1)


@pytest.mark.parametrize("given", [[1, 128, 96, 3], [1, 3, 128, 96]])
@pytest.mark.parametrize("last", [False, True])
def test_the_order_of_heat_maps_is_told_by_their_number(
    monkeypatch: pytest.MonkeyPatch, given: list[int], *, last: bool
) -> None:
    heat = np.zeros((1, 17, 32, 24))
    heat[:, :, 10, 5] = 1.0
    heat = heat.transpose(0, 2, 3, 1) if last else heat
    found = with_outputs(monkeypatch, given, [heat], decoding="heatmaps").points(PICTURE)
    np.testing.assert_allclose(found, np.tile([20.0, 40.0, 1.0], (17, 1)))


@pytest.mark.parametrize(
    ("shape", "fields"),
    [
        ((1, 3, 17), {"decoding": "coordinates"}),
        ((1, 34, 4), {"decoding": "coordinates", "columns": ["x", "y"]}),
        ((1, 34, 2), {"decoding": "coordinates", "columns": ["x", "y"]}),
        ((1, 24, 32, 24), {"decoding": "heatmaps"}),
    ],
)
def test_a_number_of_points_that_the_joint_set_has_not_is_refused(
    monkeypatch: pytest.MonkeyPatch, shape: tuple[int, ...], fields: dict[str, Any]
) -> None:
    with pytest.raises(Refused, match="do not match the description"):
        with_outputs(monkeypatch, [1, 3, 128, 96], [np.ones(shape)], **fields)


def test_a_file_that_describes_no_model_is_named(tmp_path: Path) -> None:
    path = tmp_path / "own.json"
    for text, error, words in (
        ("{", FileDamaged, "truncated or is not JSON"),
        ("[]", DetectorOutputsUnknown, "does not specify a model"),
        ('{"model": "own.pt"}', DetectorOutputsUnknown, "own.pt is not the name of a model"),
        ('{"model": "../own.onnx"}', DetectorOutputsUnknown, "is not the name of a model"),
        ('{"model": "..\\\\own.onnx"}', DetectorOutputsUnknown, "is not the name of a model"),
        ('{"model": "own.onnx", "outputs": ["' + 20_000 * "x" + '"]}', FileDamaged, "larger than"),
        ('{"model": "own.onnx", "joint_set": "COCO"}', DetectorOutputsUnknown, "joint set COCO is not known"),
        ('{"model": "own.onnx", "joint_set": "COCO_17"}', DetectorMissing, "no such model"),
        (f'{{"model": "{"own" * 100}.onnx", "joint_set": "COCO_17"}}', DetectorMissing, "no such model"),
    ):
        path.write_text(text)
        with pytest.raises(error, match=words):
            chosen_detector(str(path))
