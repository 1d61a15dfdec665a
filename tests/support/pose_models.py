"""Small ONNX pose models whose answers are known: they find the brightest red, green and blue point of a picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

KEYPOINTS = 17


def write_rtmpose(path: Path, width: int = 96, height: int = 128, keypoints: int = KEYPOINTS) -> Path:
    """Write a SimCC model: keypoint k is where channel k mod 3 is brightest."""
    onnx = pytest.importorskip("onnx")
    h, t = onnx.helper, onnx.TensorProto
    channels = h.make_tensor("channels", t.INT64, [keypoints], np.arange(keypoints) % 3)
    nodes = [
        h.make_node("ReduceMax", ["picture"], ["by_x"], axes=[2], keepdims=0),
        h.make_node("ReduceMax", ["picture"], ["by_y"], axes=[3], keepdims=0),
        h.make_node("Gather", ["by_x", "channels"], ["simcc_x"], axis=1),
        h.make_node("Gather", ["by_y", "channels"], ["simcc_y"], axis=1),
    ]
    outputs = [("simcc_x", [1, keypoints, width]), ("simcc_y", [1, keypoints, height])]
    return _written(path, nodes, [channels], ("picture", t.FLOAT, [1, 3, height, width]), outputs)


def write_heatmaps(path: Path, width: int = 96, height: int = 128, keypoints: int = KEYPOINTS) -> Path:
    """Write a model of heat maps: map k is channel k mod 3."""
    onnx = pytest.importorskip("onnx")
    channels = onnx.helper.make_tensor("channels", onnx.TensorProto.INT64, [keypoints], np.arange(keypoints) % 3)
    nodes = [onnx.helper.make_node("Gather", ["picture", "channels"], ["heat"], axis=1)]
    given = ("picture", onnx.TensorProto.FLOAT, [1, 3, height, width])
    return _written(path, nodes, [channels], given, [("heat", [1, keypoints, height, width])])


def write_movenet(path: Path, side: int = 96) -> Path:
    """Write a model of MoveNet's inputs and outputs: keypoint k is where channel k mod 3 is brightest, score 0.9."""
    onnx = pytest.importorskip("onnx")
    h, t = onnx.helper, onnx.TensorProto
    constants = [
        h.make_tensor("channels", t.INT64, [KEYPOINTS], np.arange(KEYPOINTS) % 3),
        h.make_tensor("side", t.FLOAT, [1], [float(side)]),
        h.make_tensor("score", t.FLOAT, [1, KEYPOINTS, 1], np.full(KEYPOINTS, 0.9)),
        h.make_tensor("shape", t.INT64, [4], [1, 1, KEYPOINTS, 3]),
    ]
    nodes = [h.make_node("Cast", ["picture"], ["f"], to=t.FLOAT)]
    for axis, name in ((2, "y"), (1, "x")):
        nodes += [
            h.make_node("ReduceMax", ["f"], [f"{name}_row"], axes=[axis], keepdims=0),
            h.make_node("ArgMax", [f"{name}_row"], [f"{name}_at"], axis=1, keepdims=0),
            h.make_node("Cast", [f"{name}_at"], [f"{name}_f"], to=t.FLOAT),
            h.make_node("Div", [f"{name}_f", "side"], [f"{name}_share"]),
            h.make_node("Gather", [f"{name}_share", "channels"], [f"{name}_k"], axis=1),
            h.make_node("Unsqueeze", [f"{name}_k"], [f"{name}_u"], axes=[2]),
        ]
    nodes += [
        h.make_node("Concat", ["y_u", "x_u", "score"], ["rows"], axis=2),
        h.make_node("Reshape", ["rows", "shape"], ["output_0"]),
    ]
    return _written(
        path, nodes, constants, ("picture", t.INT32, [1, side, side, 3]), [("output_0", [1, 1, KEYPOINTS, 3])]
    )


def write_constant(path: Path, outputs: dict[str, np.ndarray], size: tuple[int, int] = (96, 128)) -> Path:
    """Write a model that answers these arrays to every picture (1, 3, height, width) of the size (width, height)."""
    onnx = pytest.importorskip("onnx")
    h, t = onnx.helper, onnx.TensorProto
    constants = [h.make_tensor("none", t.FLOAT, [1], [0.0])]
    nodes = [
        h.make_node("ReduceMax", ["picture"], ["top"], axes=[0, 1, 2, 3], keepdims=0),
        h.make_node("Mul", ["top", "none"], ["zero"]),
    ]
    for name, value in outputs.items():
        constants.append(h.make_tensor(f"{name}_is", t.FLOAT, list(value.shape), value.astype(np.float32).ravel()))
        nodes.append(h.make_node("Add", [f"{name}_is", "zero"], [name]))
    told = [(name, list(value.shape)) for name, value in outputs.items()]
    return _written(path, nodes, constants, ("picture", t.FLOAT, [1, 3, size[1], size[0]]), told)


def _written(path: Path, nodes: list, constants: list, given: tuple, outputs: list) -> Path:
    onnx = pytest.importorskip("onnx")
    h, t = onnx.helper, onnx.TensorProto
    infos = [h.make_tensor_value_info(name, t.FLOAT, shape) for name, shape in outputs]
    graph = h.make_graph(nodes, "stand-in", [h.make_tensor_value_info(*given)], infos, constants)
    model = h.make_model(graph, opset_imports=[h.make_opsetid("", 11)])
    model.ir_version = 8
    onnx.save(model, str(path))
    return path
