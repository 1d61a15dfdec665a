"""Draw an image for each pipeline step, and write preview videos of the detections."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path

import numpy as np

from solver_backend.camera_calibration.calibration_check import CalibrationCheck
from solver_backend.camera_calibration.pictures import INK, SIDE, Canvas
from solver_backend.exchange.progress import Progress, silent
from solver_backend.io.png import read_png
from solver_backend.types import Cameras, JointSet
from solver_backend.videos.detect.detect_videos import Glance
from solver_backend.videos.files.video import probe, read_pictures, write_video
from solver_backend.videos.sync.clocks import Clocks
from solver_backend.videos.sync.synchronise import speeds
from solver_backend.videos.video_detections import VideoDetections

FAINT = (80, 84, 90)
COLOURS = (
    *((236, 112, 70), (82, 178, 255), (122, 204, 92), (214, 120, 230)),
    *((240, 204, 80), (120, 220, 220), (250, 140, 170), (170, 150, 250)),
)
"""RGB colour of each camera. The colours repeat."""


def mosaic(pictures: Sequence[np.ndarray], titles: Sequence[str]) -> Canvas:
    """Arrange images with their titles in a grid."""
    canvas, columns = Canvas(), max(1, int(np.ceil(np.sqrt(len(pictures)))))
    width, height = SIDE / columns, SIDE / max(1, int(np.ceil(len(pictures) / columns)))
    for i, (rgb, title) in enumerate(zip(pictures, titles, strict=True)):
        x, y = width * (i % columns), height * (i // columns)
        canvas.picture(x + 3, y + 22, width - 6, height - 25, rgb)
        canvas.text(x + 6, y + 16, title, COLOURS[i % len(COLOURS)])
    return canvas


PREVIEW_HEIGHT = 720  # Largest length of a preview's short side in pixels.
PEOPLE_COLOURS = np.array(
    [[60, 220, 90], [255, 140, 40], [70, 160, 255], [240, 80, 220], [250, 230, 60], [120, 240, 240]]
)
"""RGB colour of each person, by track."""
_SIDE_CHAINS = (
    *(("shoulder", "hip"), ("shoulder", "elbow"), ("elbow", "wrist")),
    *(("hip", "knee"), ("knee", "ankle"), ("ankle", "big_toe")),
)
_CHAINS = (
    *(("left_shoulder", "right_shoulder"), ("left_hip", "right_hip")),
    *((f"{side}_{a}", f"{side}_{b}") for side in ("left", "right") for a, b in _SIDE_CHAINS),
)


def write_previews(
    found: Sequence[VideoDetections], folder: Path, progress: Progress = silent, *, overwrite: bool = False
) -> list[Path]:
    """Write a preview video of the detections for each video. Return the paths."""
    written, total, done = [], sum(item.num_frames for item in found), 0
    for item in found:
        path = folder / f"{item.name}_detections.mp4"
        progress("Drawing previews", done, total)
        write_video(path, _drawn(item), max(item.fps, 1.0), overwrite=overwrite)
        written.append(path)
        done += item.num_frames
    progress("Drawing previews", total, total)
    return written


def _drawn(item: VideoDetections) -> Iterator[np.ndarray]:
    step = max(1, min(item.size) // PREVIEW_HEIGHT)
    for picture in read_pictures(probe(item.video)):
        if picture.number >= item.num_frames:
            return
        small = np.ascontiguousarray(picture.rgb[::step, ::step])
        yield draw_people(small, item, picture.number, step)


def draw_people(rgb: np.ndarray, item: VideoDetections, frame: int, step: int = 1) -> np.ndarray:
    """Draw a frame's skeletons onto an image that contains every ``step``-th pixel of the video."""
    for slot in np.flatnonzero(item.track[frame] >= 0):
        colour = PEOPLE_COLOURS[item.track[frame, slot] % len(PEOPLE_COLOURS)]
        _person(rgb, item.joint_set, item.xy[frame, slot] / step, item.confidence[frame, slot], colour)
    return rgb


def _person(rgb: np.ndarray, joint_set: JointSet, points: np.ndarray, sure: np.ndarray, colour: np.ndarray) -> None:
    names = joint_set.keypoints
    for a, b in ((names.index(a), names.index(b)) for a, b in _CHAINS if a in names and b in names):
        if sure[a] > 0 and sure[b] > 0:
            count = int(np.abs(points[b] - points[a]).max()) + 2
            _dots(rgb, np.linspace(points[a], points[b], count), colour, 1)
    _dots(rgb, points[sure > 0], np.array([255, 255, 255]), 2)


def _dots(rgb: np.ndarray, points: np.ndarray, colour: np.ndarray, radius: int) -> None:
    reach = np.arange(-radius, radius + 1)
    x, y = (np.round(points[:, axis]).astype(int)[:, None, None] for axis in (0, 1))
    x, y = np.broadcast_arrays(x + reach[:, None], y + reach)
    inside = (x >= 0) & (y >= 0) & (x < rgb.shape[1]) & (y < rgb.shape[0])
    rgb[y[inside], x[inside]] = colour


LOOKED_AT = 240  # Number of first images from which one is shown. Later ones in a long video take time to reach.
SHOWN_S = 12.0  # Length of the speed curves in seconds.
_LEFT, _TOP, _RIGHT = 40, 30, 190  # Margins around the speed curves in px. The right margin contains the camera names.
_TICKS_S, _MOST_TICKS = (0.1, 0.2, 0.5, 1.0, 2.0), 13
_WEDGE = 90.0  # Length of the wedge that shows a camera's field of view in the plan, in pixels.


def detections_picture(found: Sequence[VideoDetections], path: Path) -> Path:
    """Draw one image of each video with its detected people. Return the path of the drawing."""
    drawn, titles = [], []
    for item in found:
        sure = item.confidence[:LOOKED_AT].mean(-1).max(-1) if item.confidence.size else np.zeros(1)
        number = int(np.argmax(sure))
        picture = next(islice(read_pictures(probe(item.video)), number, None))
        step = max(1, min(item.size) // 540)
        drawn.append(draw_people(np.ascontiguousarray(picture.rgb[::step, ::step]), item, number, step))
        seen = float((item.confidence > 0).any((-1, -2)).mean()) if item.confidence.size else 0.0
        titles.append(f"{item.name}: a person in {seen:.0%}")
    return mosaic(drawn, titles).save(path)


def glances_picture(glances: Sequence[Glance], path: Path, names: Mapping[Path, str]) -> Path:
    """Draw the most recent image of each video with its detected people. Return the path of the drawing."""
    drawn = []
    for glance in glances:
        step = max(1, min(glance.rgb.shape[:2]) // 540)
        small = np.ascontiguousarray(glance.rgb[::step, ::step])
        for number, person in enumerate(glance.people):
            colour = PEOPLE_COLOURS[number % len(PEOPLE_COLOURS)]
            _person(small, glance.joint_set, person[:, :2] / step, np.nan_to_num(person[:, 2]), colour)
        drawn.append(small)
    return mosaic(drawn, [names[glance.video] for glance in glances]).save(path)


def draw_boards(folder: Path, names: Sequence[str], path: Path) -> Path:
    """Draw the board coverage images of all cameras side by side. Return the path of the drawing."""
    there = [name for name in names if (folder / f"{name}.png").is_file()]
    return mosaic([read_png(folder / f"{name}.png") for name in there], there).save(path)


def clocks_picture(found: Sequence[VideoDetections], clocks: Clocks, path: Path) -> Path:
    """Draw the limb speeds in each view before and after synchronisation. Return the path of the drawing."""
    curves = []
    for c, item in enumerate(found):
        if item.num_frames < 2:
            continue  # the speed cannot be computed from a single image
        track = item.of_track(item.main_track())[0]
        signal = speeds(track, item.times_s - item.times_s[0], item.joint_set)
        strength = np.sqrt((signal.values**2).mean(-1))
        when = signal.start_s + np.arange(len(strength)) / signal.rate_hz
        curves.append((when, clocks.from_video(c, when), strength / max(float(np.quantile(strength, 0.98)), 1e-9)))
    canvas = Canvas()
    if not curves:
        return canvas.save(path)
    start = max(0.0, max(float(c[1][0]) for c in curves))
    span = start, start + min(SHOWN_S, max(1.0, max(float(c[1][-1]) for c in curves) - start))
    _curves(canvas, [(c[0], c[2]) for c in curves], span, 0, "as filmed")
    _curves(canvas, [(c[1], c[2]) for c in curves], span, SIDE // 2, "on one clock")
    for c, name in enumerate(clocks.names):
        words = f"{name} {1e3 * clocks.offset_s[c]:+.1f} ms"
        canvas.text(SIDE - _RIGHT + 10, _TOP + 18 * (c + 1), words, COLOURS[c % len(COLOURS)], 0.42)
    return canvas.save(path)


def _curves(
    canvas: Canvas, curves: list[tuple[np.ndarray, np.ndarray]], span: tuple[float, float], top: int, title: str
) -> None:
    height, width = SIDE // 2 - _TOP - 24, SIDE - _LEFT - _RIGHT
    canvas.text(10, top + 20, f"speed of the limbs, {title}")
    step = next((s for s in _TICKS_S if (span[1] - span[0]) / s <= _MOST_TICKS), _TICKS_S[-1])
    for second in step * np.arange(np.ceil(span[0] / step), np.floor(span[1] / step + 1e-6) + 1):
        x = _LEFT + width * (second - span[0]) / (span[1] - span[0])
        canvas.line(np.array([[x, top + _TOP], [x, top + _TOP + height]]), FAINT)
        canvas.text(x - 10, top + _TOP + height + 16, f"{second:g} s", INK, 0.4)
    for c, (when, values) in enumerate(curves):
        inside = (when >= span[0]) & (when <= span[1])
        x = _LEFT + width * (when[inside] - span[0]) / (span[1] - span[0])
        y = top + _TOP + height * (1.0 - np.clip(values[inside], 0, 1.2) / 1.2)
        canvas.line(np.stack([x, y], axis=-1), COLOURS[c % len(COLOURS)], 1)


def cameras_picture(cameras: Cameras, walked: np.ndarray, path: Path) -> Path:
    """Draw the cameras and the person's path from above. Return the path of the drawing.

    Args:
        walked: (F, 3) positions of the person in metres, NaN where unknown.
    """
    centres = cameras.centres[:, :2]
    way = walked[np.isfinite(walked).all(-1), :2]
    shown = np.concatenate([centres, way, centres.mean(0)[None] + 0.5, centres.mean(0)[None] - 0.5])
    low, high = shown.min(0), shown.max(0)
    scale = (SIDE - 260) / float((high - low).max())
    middle = (low + high) / 2

    def at(points: np.ndarray) -> np.ndarray:
        return SIDE / 2 + (points - middle) * scale * np.array([1.0, -1.0])

    canvas = Canvas()
    reach = SIDE / 2 / scale
    for axis in (0, 1):
        for metre in range(int(np.floor(middle[axis] - reach)), int(np.ceil(middle[axis] + reach)) + 1):
            ends = np.stack([middle - reach, middle + reach])
            ends[:, axis] = metre
            canvas.line(at(ends), FAINT)
    canvas.line(at(np.where(np.isfinite(walked[:, :2]), walked[:, :2], np.nan)), INK, 2)
    for c, name in enumerate(cameras.names):
        colour = COLOURS[c % len(COLOURS)]
        ahead = cameras.R[c, 2, :2] / max(float(np.linalg.norm(cameras.R[c, 2, :2])), 1e-9)
        half = float(np.arctan2(cameras.image_size[c, 0] / 2, cameras.K[c, 0, 0]))
        turns = [np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]) for a in (half, -half)]
        wedge = np.stack([centres[c], *(centres[c] + _WEDGE / scale * turn @ ahead for turn in turns)])
        canvas.line(at(wedge), colour, 2, closed=True)
        # Put the name behind the camera, outside its field of view.
        (x, y), words = at(centres[c]), f"{name} {cameras.centres[c, 2]:.2f} m"
        wide = canvas.text_width(words, 0.45)
        left = x - wide / 2 - ahead[0] * (wide / 2 + 8)
        left, y = np.clip(left, 4, SIDE - wide - 4), np.clip(y + 16 * ahead[1] + 4, 14, SIDE - 30)
        canvas.text(left, y, words, colour, 0.45)
    canvas.text(10, SIDE - 12, "from above, with lines every 1 m and heights after the names", INK, 0.45)
    return canvas.save(path)


def check_picture(names: Sequence[str], check: CalibrationCheck, path: Path) -> Path:
    """Draw each camera's error over image regions and over time. Return the path of the drawing."""
    canvas, rows = Canvas(), len(names)
    height = min(150.0, (SIDE - 60) / rows)
    most = max(2.0 * check.all_px, 1.0)
    canvas.text(10, 20, "error by part of the image, px")
    canvas.text(SIDE // 2, 20, "distance to epipolar lines over the take, px")
    tall = max(float(np.nanmax(np.nan_to_num(check.epipolar_px))), 1.0) * 1.3
    for c, name in enumerate(names):
        y, colour = 34 + c * height, COLOURS[c % len(COLOURS)]
        canvas.text(10, y + 20, name, colour)
        canvas.text(10, y + 40, f"{check.camera_px[c]:.1f} px", INK, 0.45)
        w, h = 70.0, (height - 14) / 3
        for row in range(3):
            for column in range(3):
                value = float(check.region_px[c, row, column])
                hot = float(np.clip(np.nan_to_num(value) / most, 0, 1))
                tint = (int(60 + 180 * hot), int(110 - 40 * hot), int(90 - 40 * hot)) if np.isfinite(value) else FAINT
                canvas.box(130 + w * column, y + 6 + h * row, w - 2, h - 2, tint)
                words = f"{value:.1f}" if np.isfinite(value) else "-"
                canvas.text(130 + w * column + 18, y + 4 + h * row + h / 2 + 4, words, INK, 0.42)
        track = check.epipolar_px[c]
        if np.isfinite(track).any():
            words = f"{np.nanmin(track):.1f} to {np.nanmax(track):.1f} px"
            canvas.text(SIDE / 2 + 10, y + 16, words, INK, 0.42)
        x = np.linspace(SIDE / 2 + 10, SIDE - 20, len(track))
        base = y + height - 8
        canvas.line(np.array([[SIDE / 2, base], [SIDE - 10, base]]), FAINT)
        points = np.stack([x, base - (height - 22) * track / tall], axis=-1)
        canvas.line(points, colour, 2)
        canvas.dots(points, colour)
    return canvas.save(path)
