"""A shot as COCO's person keypoints: pictures, boxes and 17 keypoints with their visibility, in one JSON file.

Pixels count from the centre of the top-left one, as everywhere here. Visibility is COCO's: 0 not in the picture,
1 in the picture but hidden, 2 seen.
"""

from __future__ import annotations

import json

import numpy as np

from solver_backend.synthesis.studio.truth import OUTSIDE, VISIBLE, Truth
from solver_backend.types import Cameras, JointSet

_SKELETON = [
    [16, 14], [14, 12], [17, 15], [15, 13], [12, 13], [6, 12], [7, 13], [6, 7], [6, 8], [7, 9], [8, 10], [9, 11],
    [2, 3], [1, 2], [1, 3], [2, 4], [3, 5], [4, 6], [5, 7],
]  # fmt: skip


def coco_text(cameras: Cameras, truth: Truth, pictures: str, shot: str) -> str:
    """Return the JSON of a shot.

    Args:
        cameras: C cameras.
        truth: of F frames.
        pictures: folder of the kind of pictures that are annotated, such as 'rgb'.
        shot: name of the shot.
    """
    chosen = JointSet.COCO_17
    xy, visibility = truth.xy[chosen], truth.visibility[chosen]
    state = np.where(visibility == VISIBLE, 2, np.where(visibility == OUTSIDE, 0, 1))
    images, annotations = [], []
    for view, name in enumerate(cameras.names):
        width, height = cameras.image_size[view].tolist()
        for frame in range(xy.shape[1]):
            number = view * xy.shape[1] + frame
            images.append(
                {"id": number, "file_name": f"{pictures}/{name}/{frame:06d}.png", "width": width, "height": height}
            )
            box = truth.boxes[view, frame]
            if not np.isfinite(box).all():
                continue
            known = state[view, frame] > 0
            rows = np.where(known[:, None], np.round(xy[view, frame], 2), 0.0)
            flat = np.concatenate([rows, state[view, frame][:, None]], axis=1).ravel().tolist()
            size = np.round([box[0], box[1], box[2] - box[0], box[3] - box[1]], 2)
            annotations.append(
                {
                    "id": number, "image_id": number, "category_id": 1, "iscrowd": 0, "bbox": size.tolist(),
                    "area": round(float(size[2] * size[3]), 1), "num_keypoints": int(known.sum()),
                    "keypoints": [int(v) if i % 3 == 2 else v for i, v in enumerate(flat)],
                    "truncation": round(1.0 - float(truth.inside[view, frame]), 4),
                }
            )  # fmt: skip
    category = {
        "id": 1, "name": "person", "supercategory": "person", "keypoints": list(chosen.keypoints),
        "skeleton": _SKELETON,
    }  # fmt: skip
    info = {"description": shot, "note": "pixel (0, 0) is the centre of the top-left pixel"}
    return json.dumps({"info": info, "images": images, "annotations": annotations, "categories": [category]})
