"""Draw the contact sheet of a data set, and write its data card."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.verb_results import ShotRecord
from solver_backend.io.png import png_bytes, read_png
from solver_backend.synthesis.studio.costume import LABELS
from solver_backend.synthesis.studio.data_set import SHOTS, read_data_set
from solver_backend.synthesis.studio.sensor_pictures import SECTOR_DEG
from solver_backend.synthesis.studio.spec import Spec

SHEET, CARD = "contact_sheet.png", "card.md"
_TILE = (208, 156)  # Width and height of an image in pixels. Chosen by hand.
_COLUMNS, _TILES = 6, 24
_SHOWN = ("rgb", "infrared", "depth", "masks", "normals")
_DIRECTIONS = ("front", "front left", "left", "back left", "back", "back right", "right", "front right")
_SECTORS = [f"{low} to {low + SECTOR_DEG}" for low in range(0, 180, SECTOR_DEG)]  # Degrees.
# Red, green and blue of each label.
_COLOURS = np.frombuffer(
    bytes.fromhex("141418 e0965a be3c3c 3250aa 327878 3c3c3c 50321e ffffff 5a9646 8c8c91"), np.uint8
)
_COLOURS = _COLOURS.reshape(-1, 3)  # One row per label.


def write_card(out: Path) -> list[Path]:
    """Write the data card and the contact sheet of a data set, and return their paths."""
    spec, records = read_data_set(out)
    sheet = contact_sheet(out, records)
    if sheet is not None:
        (out / SHEET).write_bytes(png_bytes(sheet))
    (out / CARD).write_text(card_text(spec, records, sheet is not None), encoding="utf-8", newline="\n")
    return [out / CARD] if sheet is None else [out / CARD, out / SHEET]


def contact_sheet(out: Path, records: list[ShotRecord]) -> np.ndarray | None:
    """Return an (h, w, 3) uint8 sheet of up to 24 images from different shots, or None without images."""
    tiles = []
    for i in range(_TILES):
        record = records[i * len(records) // _TILES if len(records) >= _TILES else i % len(records)]
        camera = record["cameras"][i % len(record["cameras"])]
        frame = int((i * 0.382) % 1.0 * record["frames"])
        paths = [(kind, out / SHOTS / record["name"] / kind / camera / f"{frame:06d}.png") for kind in _SHOWN]
        tiles += [_fitted(shown(kind, read_png(path))) for kind, path in paths if path.is_file()][:1]
    if not tiles:
        return None
    width, height = _TILE
    rows = -(-len(tiles) // _COLUMNS)
    sheet = np.full((rows * (height + 4) + 4, _COLUMNS * (width + 4) + 4, 3), 24, np.uint8)
    for i, tile in enumerate(tiles):
        y, x = 4 + i // _COLUMNS * (height + 4), 4 + i % _COLUMNS * (width + 4)
        sheet[y : y + height, x : x + width] = tile
    return sheet


def shown(kind: str, picture: np.ndarray) -> np.ndarray:
    """Convert a rendered image, such as depth or masks, to (h, w, 3) uint8 for display."""
    if kind == "masks":
        return _COLOURS[np.minimum(picture, len(LABELS) - 1)]
    if picture.ndim == 3:
        return picture[..., :3].astype(np.uint8)
    if kind == "infrared":
        grey = 255 * np.sqrt(np.clip(picture / 12000.0, 0, 1))
    else:
        grey = np.where(picture > 0, 255 - np.clip(picture / 5000.0, 0, 1) * 220, 0)
    return np.repeat(grey.astype(np.uint8)[..., None], 3, axis=2)


def _fitted(picture: np.ndarray) -> np.ndarray:
    """Crop an image to the aspect ratio of a tile, and scale it down by averaging."""
    width, height = _TILE
    scale = min(picture.shape[1] / width, picture.shape[0] / height)
    x0, y0 = (picture.shape[1] - scale * width) / 2, (picture.shape[0] - scale * height) / 2
    total = np.zeros((height, width, 3))
    for dy, dx in product((np.arange(3) + 0.5) / 3, repeat=2):
        y = np.clip((y0 + (np.arange(height) + dy) * scale).astype(int), 0, picture.shape[0] - 1)
        x = np.clip((x0 + (np.arange(width) + dx) * scale).astype(int), 0, picture.shape[1] - 1)
        total += picture[y[:, None], x]
    return (total / 9).astype(np.uint8)


def card_text(spec: Spec, records: list[ShotRecord], has_sheet: bool) -> str:
    """Return the data card of a data set in Markdown."""
    views = np.sum([record["views"] for record in records], axis=0)
    frames = sum(record["frames"] for record in records)
    pictures = sum(record["frames"] * len(record["cameras"]) * len(record["film"]) for record in records)
    facts = {"shots": len(records), "frames": f"{frames} at {spec.fps:g} a second", "pictures": pictures}
    facts |= {"kinds": ", ".join(spec.film) or "none", "seed": spec.seed}
    facts |= {"people": len({record["person"] for record in records})}
    keys = {"motions": "motion", "camera_arrays": "camera_array", "looks": "look"}
    facts |= {name: _listed(records, key) for name, key in keys.items()}
    facts |= {name: _listed(records, name) for name in ("clothes", "hair", "light")}
    facts |= {"markers": f"{records[0]['markers']} ({spec.markers})" if spec.markers else "none"}
    facts |= {"keypoints": f"{spec.joint_set.value} in captures, every joint set in truth.npz"}
    facts |= {"visible": f"{100 * np.mean([record['visible'] for record in records]):.0f} % of keypoints"}
    inside, colour = np.mean([record["inside"] for record in records]), f"{spec.rgb.engine}, {spec.rgb.samples} samples"
    facts |= {"within the picture": f"{100 * inside:.0f} % of the person"}
    facts |= {"engine of colour": colour if "rgb" in spec.film else "none"}
    lines = [f"# {spec.name}", "", *(["![contact sheet](contact_sheet.png)", ""] if has_sheet else [])]
    lines += ["| what | |", "|---|---|", *(f"| {name} | {value} |" for name, value in facts.items()), ""]
    lines += ["Seen from, share of views:", "", "| " + " | ".join(_DIRECTIONS) + " |", "|---" * 8 + "|"]
    lines += ["| " + " | ".join(f"{100 * v / max(views.sum(), 1):.0f} %" for v in views) + " |", ""]
    lines += ["Poses, share of frames by degrees:", "", f"| | {' | '.join(_SECTORS)} |", "|---" * 7 + "|"]
    for name in records[0]["poses"]:
        counts = np.sum([record["poses"][name] for record in records], axis=0)
        lines.append(f"| {name} | " + " | ".join(f"{100 * n / max(counts.sum(), 1):.0f} %" for n in counts) + " |")
    masks = ", ".join(f"{i} {name}" for i, name in enumerate(LABELS))
    return "\n".join([*lines, "", _LICENCE, "", _CONVENTIONS.format(masks=masks), ""])


_LICENCE = (
    "Made by Manifold MoCap's studio. The body and the choreography that ship are CC0-1.0. Images and truth are "
    "yours. Data made from your own motion files are under the licences of those files."
)
_CONVENTIONS = (
    "Pixel (0, 0) is the centre of the top-left pixel. Lengths are in metres, Z is up, and `x_cam = R x_world + t` in "
    "OpenCV's axes. "
    "Depth is in millimetres along the optical axis, 0 where there is none. Masks: {masks}. Visibility in truth.npz: "
    "0 outside the image, 1 behind the own body, 2 behind furniture, 3 seen."
)


def _listed(records: list[ShotRecord], key: str) -> str:
    values: list[Any] = [dict(record)[key] for record in records]
    names, counts = np.unique(values, return_counts=True)
    return ", ".join(f"{name} ({count})" for name, count in zip(names.tolist(), counts.tolist(), strict=True))
