"""Bring your own ONNX model: ``python own_model.py FOLDER``, then ``manifold from-videos VIDEOS --detector own.json``.

It writes ``own.onnx`` and its description ``own.json``. The small model runs anywhere: it finds 17 coloured dots on
black and answers a heat map for each. Put your network's export in its place (``torch.onnx.export``). Needs ``onnx``.
"""

import json
import sys
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper

COLOURS = np.array(
    [[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 0], [0, 255, 255], [255, 0, 255], [255, 128, 0], [128, 255, 0],
     [0, 255, 128], [0, 128, 255], [128, 0, 255], [255, 0, 128], [255, 255, 128], [128, 255, 255], [255, 128, 255],
     [255, 128, 128], [128, 255, 128]]
)  # fmt: skip
"""RGB of the dots, in the order of COCO_17: nose, eyes, ears, shoulders, elbows, wrists, hips, knees, ankles."""
WIDTH, HEIGHT = 192, 256
LIKE = 0.06  # Square of the largest difference from a colour, levels from 0 to 1.
DESCRIPTION = {
    "model": "own.onnx",
    "joint_set": "COCO_17",
    "size": [WIDTH, HEIGHT],
    "decoding": "heatmaps",
    "outputs": ["heat"],
    "mean": [0, 0, 0],
    "std": [255, 255, 255],
}


def model() -> onnx.ModelProto:
    """Return the model: ``heat = relu(1 - |picture - colour|² / LIKE)``, averaged over 5 x 5 pixels."""
    colours = (COLOURS / 255.0).astype(np.float32)
    constants = [
        helper.make_tensor("colours", TensorProto.FLOAT, [len(colours), 3, 1, 1], colours.ravel()),
        helper.make_tensor("unlike", TensorProto.FLOAT, [1], [-1.0 / LIKE]),
        helper.make_tensor("one", TensorProto.FLOAT, [1], [1.0]),
    ]
    nodes = [
        helper.make_node("Sub", ["picture", "colours"], ["off"]),
        helper.make_node("ReduceSumSquare", ["off"], ["square"], axes=[1], keepdims=1),
        helper.make_node("Mul", ["square", "unlike"], ["less"]),
        helper.make_node("Add", ["less", "one"], ["like"]),
        helper.make_node("Relu", ["like"], ["sharp"]),
        helper.make_node("AveragePool", ["sharp"], ["maps"], kernel_shape=[5, 5], pads=[2, 2, 2, 2]),
        helper.make_node("Transpose", ["maps"], ["heat"], perm=[1, 0, 2, 3]),
    ]
    given = helper.make_tensor_value_info("picture", TensorProto.FLOAT, [1, 3, HEIGHT, WIDTH])
    heat = helper.make_tensor_value_info("heat", TensorProto.FLOAT, [1, len(colours), HEIGHT, WIDTH])
    graph = helper.make_graph(nodes, "dots", [given], [heat], constants)
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 11)])
    made.ir_version = 8
    return made


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    onnx.save(model(), str(folder / DESCRIPTION["model"]))
    (folder / "own.json").write_text(json.dumps(DESCRIPTION, indent=2) + "\n", encoding="utf-8")
