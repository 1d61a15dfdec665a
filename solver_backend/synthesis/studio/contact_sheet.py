"""A contact sheet: pictures of as many shots as fit, and a data card that states what a data set holds."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solver_backend.exchange.verb_results import ShotRecord
from solver_backend.io.png import png_bytes, read_png
from solver_backend.synthesis.studio.costume import LABELS
from solver_backend.synthesis.studio.data_set import SHOTS, read_data_set
from solver_backend.synthesis.studio.sensor_pictures import SECTOR_DEG
from solver_backend.synthesis.studio.spec import Spec

SHEET, CARD = "contact_sheet.png", "card.md"
_TILE = (208, 156)  # Width and height of a picture, pixels; chosen by hand.
_COLUMNS, _TILES = 6, 24
_SHOWN = ("rgb", "infrared", "depth", "masks", "normals")
_DIRECTIONS = ("front", "front left", "left", "back left", "back", "back right", "right", "front right")
_SECTORS = [f"{low} to {low + SECTOR_DEG}" for low in range(0, 180, SECTOR_DEG)]  # Degrees.
_COLOURS = np.array(
    [[20, 20, 24], [224, 150, 90], [190, 60, 60], [50, 80, 170], [50, 120, 120], [60, 60, 60], [80, 50, 30],
     [255, 255, 255], [90, 150, 70], [140, 140, 145]], np.uint8,
)  # fmt: skip


def write_card(out: Path) -> list[Path]:
    """Write the data card and the contact sheet of a data set, replacing older ones, and return their paths.

    Raises:
        FileMissing, FileDamaged: there is no data set.
    """
    spec, records = read_data_set(out)
    written = [out / CARD]
    sheet = contact_sheet(out, records)
    if sheet is not None:
        (out / SHEET).write_bytes(png_bytes(sheet))
        written.append(out / SHEET)
    (out / CARD).write_text(card_text(spec, records, sheet is not None), encoding="utf-8", newline="\n")
    return written


def contact_sheet(out: Path, records: list[ShotRecord]) -> np.ndarray | None:
    """Return (h, w, 3) uint8 of up to 24 pictures spread over shots, cameras and time; None where none was filmed."""
    tiles = []
    for i in range(_TILES):
        record = records[i * len(records) // _TILES if len(records) >= _TILES else i % len(records)]
        camera = record["cameras"][i % len(record["cameras"])]
        frame = int((i * 0.382) % 1.0 * record["frames"])
        folder = out / SHOTS / record["name"]
        kind = next((kind for kind in _SHOWN if (folder / kind / camera / f"{frame:06d}.png").is_file()), None)
        if kind is not None:
            tiles.append(_fitted(shown(kind, read_png(folder / kind / camera / f"{frame:06d}.png"))))
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
    """Return a picture of any kind as (h, w, 3) uint8 to look at."""
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
    """Return the picture cut to the tile's shape and averaged down to its size."""
    width, height = _TILE
    scale = min(picture.shape[1] / width, picture.shape[0] / height)
    x0, y0 = (picture.shape[1] - scale * width) / 2, (picture.shape[0] - scale * height) / 2
    total = np.zeros((height, width, 3))
    part = (np.arange(3) + 0.5) / 3
    for dy in part:
        for dx in part:
            y = np.clip((y0 + (np.arange(height) + dy) * scale).astype(int), 0, picture.shape[0] - 1)
            x = np.clip((x0 + (np.arange(width) + dx) * scale).astype(int), 0, picture.shape[1] - 1)
            total += picture[y[:, None], x]
    return (total / 9).astype(np.uint8)


def card_text(spec: Spec, records: list[ShotRecord], has_sheet: bool) -> str:
    """Return the data card as Markdown."""
    views = np.sum([record["views"] for record in records], axis=0)
    frames = sum(record["frames"] for record in records)
    pictures = sum(record["frames"] * len(record["cameras"]) * len(record["film"]) for record in records)
    facts = {
        "shots": len(records), "frames": f"{frames} at {spec.fps:g} a second", "pictures": pictures,
        "kinds": ", ".join(spec.film) or "none", "seed": spec.seed,
        "people": len({record["person"] for record in records}),
        "motions": _listed(records, "motion"), "camera_arrays": _listed(records, "camera_array"),
        "looks": _listed(records, "look"),
        "clothes": _listed(records, "clothes"), "hair": _listed(records, "hair"), "light": _listed(records, "light"),
        "markers": f"{records[0]['markers']} ({spec.markers})" if spec.markers else "none",
        "keypoints": f"{spec.joint_set.value} in captures; every joint set in truth.npz",
        "visible": f"{100 * np.mean([record['visible'] for record in records]):.0f} % of keypoints",
        "within the picture": f"{100 * np.mean([record['inside'] for record in records]):.0f} % of the person",
        "engine of colour": f"{spec.rgb.engine}, {spec.rgb.samples} samples" if "rgb" in spec.film else "none",
    }  # fmt: skip
    lines = [f"# {spec.name}", "", *(["![contact sheet](contact_sheet.png)", ""] if has_sheet else [])]
    lines += ["| what | |", "|---|---|", *(f"| {name} | {value} |" for name, value in facts.items()), ""]
    lines += ["Seen from, share of views:", "", "| " + " | ".join(_DIRECTIONS) + " |", "|---" * 8 + "|"]
    lines += ["| " + " | ".join(f"{100 * v / max(views.sum(), 1):.0f} %" for v in views) + " |", ""]
    lines += ["Poses, share of frames by degrees:", "", f"| | {' | '.join(_SECTORS)} |", "|---" * 7 + "|"]
    for name in records[0]["poses"]:
        counts = np.sum([record["poses"][name] for record in records], axis=0)
        lines.append(f"| {name} | " + " | ".join(f"{100 * n / max(counts.sum(), 1):.0f} %" for n in counts) + " |")
    lines += [
        "",
        "Made by Manifold MoCap's studio. The body and the motion that ships are GPL-3.0-or-later; pictures and truth "
        "are output of the program and yours. What is made from motions that you brought is under the motions' own "
        "licences.", "",
        "Pixel (0, 0) is the centre of the top-left pixel; metres, Z up; `x_cam = R x_world + t` in OpenCV's axes. "
        "Depth is in millimetres along the optical axis, 0 where there is none. Masks: "
        + ", ".join(f"{i} {name}" for i, name in enumerate(LABELS)) + ". Visibility in truth.npz: 0 outside the "
        "picture, 1 behind the own body, 2 behind furniture, 3 seen.", "",
    ]  # fmt: skip
    return "\n".join(lines)


def _listed(records: list[ShotRecord], key: str) -> str:
    names, counts = np.unique([record[key] for record in records], return_counts=True)
    return ", ".join(f"{name} ({count})" for name, count in zip(names.tolist(), counts.tolist(), strict=True))
