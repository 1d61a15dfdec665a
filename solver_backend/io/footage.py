"""Find videos and image folders. Read video headers, chapters and focal lengths."""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from solver_backend.cameras.camera_corrections import resized
from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.exchange.outputs import open_regular
from solver_backend.io.calibration.entry import Calibration
from solver_backend.io.calibration.search import is_calibration_folder
from solver_backend.io.camera_names import name_key, natural_key
from solver_backend.types import Detections

_LARGEST_HEADER = 1 << 26  # Size limit of a header in bytes. The header for ten hours of video is smaller.
_MOST_BOXES = 10_000  # Largest number of boxes examined in a file, chosen by hand.
_QUARTER_TURNS = {(0, 1, -1, 0), (0, -1, 1, 0)}
_UNREADABLE = (OSError, struct.error, IndexError, ValueError, OverflowError)  # Errors that damaged files cause.


@dataclass(frozen=True)
class VideoHeader:
    """Frame rate, length and size in the header of a video."""

    fps: float  # Mean frame rate in frames per second.
    num_frames: int
    size: tuple[int, int]  # Stored width and height in pixels after rotation, as OpenCV and most detectors read them.


def read_video_header(path: Path | None) -> VideoHeader | None:
    """Read the header of the first video track in an MP4 or MOV file. Return None for other files or if path is None.

    ``fps = timescale * Σ count / Σ (count * duration)`` over the table of sample durations (ISO/IEC 14496-12, stts).
    """
    if path is None:
        return None
    with suppress(*_UNREADABLE), open_regular(path) as stream:
        return _video_track(memoryview(_top_level_box(stream, b"moov") or b""))
    return None


def _top_level_box(stream: BinaryIO, wanted: bytes) -> bytes | None:
    """Return the content of the first top-level MP4 box of the given type, or None."""
    for _ in range(_MOST_BOXES):
        if len(head := stream.read(8)) < 8:
            return None
        size, kind = struct.unpack(">I4s", head)
        used = 8
        if size == 1:
            size, used = struct.unpack(">Q", stream.read(8))[0], 16
        if kind == wanted:
            return stream.read(min(size - used, _LARGEST_HEADER) if size else _LARGEST_HEADER)
        if size < used:
            return None
        stream.seek(size - used, 1)
    return None


def _boxes(data: memoryview) -> Iterator[tuple[bytes, memoryview]]:
    """Yield the type and content of each box inside an MP4 box."""
    at = 0
    for _ in range(_MOST_BOXES):
        if at + 8 > len(data):
            return
        size, kind = struct.unpack_from(">I4s", data, at)
        used = 8
        if size == 1:
            size, used = struct.unpack_from(">Q", data, at + 8)[0], 16
        end = at + size if size else len(data)
        if end < at + used:
            return
        yield kind, data[at + used : end]
        at = end


def _inside(data: memoryview, *kinds: bytes) -> memoryview:
    """Follow a path of MP4 box types. Return the content of the last box, or no bytes if a box is missing."""
    for kind in kinds:
        data = next((content for found, content in _boxes(data) if found == kind), memoryview(b""))
    return data


def _video_track(moov: memoryview) -> VideoHeader | None:
    for kind, track in _boxes(moov):
        if kind != b"trak" or _inside(track, b"mdia", b"hdlr")[8:12] != b"vide":
            continue
        media = _inside(track, b"mdia", b"mdhd")
        timescale = struct.unpack_from(">I", media, 20 if media[0] == 1 else 12)[0]
        table = _inside(track, b"mdia", b"minf", b"stbl", b"stts")
        entries = struct.unpack_from(">I", table, 4)[0]
        counts, durations = np.frombuffer(table[8:], ">u4", 2 * entries).reshape(-1, 2).astype(np.float64).T
        frames, ticks = int(counts.sum()), int(counts @ durations)
        size = _stored_size(_inside(track, b"tkhd"), _inside(track, b"mdia", b"minf", b"stbl", b"stsd"))
        if not (frames and ticks and timescale and all(size)):
            return None
        return VideoHeader(timescale * frames / ticks, frames, size)
    return None


def _stored_size(tkhd: memoryview, stsd: memoryview) -> tuple[int, int]:
    """Return the image size in the first sample entry, or else the display size of the track."""
    at = 52 if tkhd[0] == 1 else 40
    a, b, _, c, d = struct.unpack_from(">5i", tkhd, at)
    width, height = (value >> 16 for value in struct.unpack_from(">II", tkhd, at + 36))
    if entry := next((content for _, content in _boxes(stsd[8:])), None):
        width, height = struct.unpack_from(">HH", entry, 24)
    rotated = tuple(value >> 16 for value in (a, b, c, d)) in _QUARTER_TURNS
    return (height, width) if rotated else (width, height)


CODEC_BLOCK = 16  # Size in pixels of the blocks to which H.264 fills up images.
VIDEOS = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".mpg", ".mpeg", ".wmv")
IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
SENSOR_RECORDING = "recording.json"  # File that describes a folder of infrared and depth sensor recordings.
_FOLDERS = ("videos", "video", "images", "footage")


def find_footage(levels: Sequence[Path], recorded: Sequence[str]) -> tuple[Path | None, ...]:
    """Find the video or image folder of each recorded camera, or None if it has none.

    ``levels`` are the folders that may contain a ``videos`` folder, nearest first.
    """
    for level in levels:
        for name in (*_FOLDERS, "."):
            folder = level / name
            if folder.is_dir() and (found := footage_in(folder)):
                matched = tuple(found.get(name_key(camera)) for camera in recorded)
                if any(matched):
                    return matched
    return (None,) * len(recorded)


def footage_in(folder: Path) -> dict[tuple[str, ...], Path]:
    """List the videos and image folders in a folder, by the ``name_key`` of their names."""
    found: dict[tuple[str, ...], Path] = {}
    for path in sorted(folder.iterdir(), key=lambda p: natural_key(p.name)):
        if path.suffix.lower() in VIDEOS and path.is_file():
            found.setdefault(name_key(path.stem), path)
        elif path.is_dir() and any(item.suffix.lower() in IMAGES for item in path.iterdir()):
            found.setdefault(name_key(path.name), path)
    return found


def with_sizes_of(
    calibration: Calibration, videos: Sequence[VideoHeader | None], detections: Detections
) -> Calibration:
    """Scale a calibration to the pixels of the detections, using the image sizes of the videos.

    A camera without a stated image size uses the size of its video. If the video and the calibration have the same
    aspect ratio and the detections only fit the video's image size, the calibration is scaled. Other differences in
    size are reported, unless a codec padded the images at the right and bottom.
    """
    cameras, notes, problems = calibration.cameras, list(calibration.notes), list(calibration.problems)
    guessed: list[str] = []
    for c, header in enumerate(videos):
        name, size = cameras.names[c], tuple(cameras.image_size[c].tolist())
        if not calibration.size_known[c]:
            if header is None:
                guessed.append(name)
            else:
                sizes = cameras.image_size.copy()
                sizes[c] = header.size
                cameras = replace(cameras, image_size=sizes)
            continue
        if header is None or size in (
            header.size,
            tuple(-(-side // CODEC_BLOCK) * CODEC_BLOCK for side in header.size),
        ):
            continue
        if _made_for_video(size, header.size, detections.xy[c]):
            cameras = resized(cameras, c, header.size)
            made, filmed = ("{} x {}".format(*pair) for pair in (size, header.size))
            notes.append(diagnostic("calibration_scaled", how="scaled", cameras=[name], made=made, filmed=filmed))
        else:
            keys = ("width", "height", "video_width", "video_height")
            figures: dict[str, Any] = dict(zip(keys, (*size, *header.size), strict=True))
            problems.append(diagnostic("video_size_differs", cameras=[name], **figures))
    if guessed:
        problems.append(diagnostic("image_size_assumed", cameras=guessed))
    return replace(calibration, cameras=cameras, notes=tuple(notes), problems=tuple(problems))


def _made_for_video(calibrated: tuple[int, ...], video: tuple[int, int], xy: np.ndarray) -> bool:
    scale = np.array(video) / np.array(calibrated)
    if abs(scale[0] / scale[1] - 1) > 0.005 or abs(scale[0] - 1) < 0.02:
        return False
    known = xy[np.isfinite(xy).all(-1)]
    if not len(known):
        return False
    reach = np.quantile(known, 0.995, axis=0)
    if scale[0] < 1:
        return bool((reach <= 1.02 * np.array(video)).all())
    return bool((reach > 1.02 * np.array(calibrated)).any())


_CHAPTER = re.compile(r"(?P<head>.*?)(?P<kind>G[HXP])(?P<chapter>\d\d)(?P<number>\d{4})(?P<tail>.*)", re.IGNORECASE)
"""GoPro file names. ``GX020101`` is chapter 2 of recording 0101. ``GH`` means H.264, ``GP`` cameras up to HERO5."""
_FIRST = re.compile(r"(?P<head>.*?)GOPR(?P<number>\d{4})(?P<tail>.*)", re.IGNORECASE)
"""Name of the first chapter on cameras up to HERO5. It is followed by ``GP01``, ``GP02`` and so on."""


def parts_of(path: Path) -> tuple[Path, ...]:
    """Return a recording's files in order: the images in a folder, or all chapters of a video, given the first."""
    if path.is_dir():
        return tuple(sorted((p for p in path.iterdir() if is_picture(p)), key=lambda p: natural_key(p.name)))
    if chapter_of(path) is None or not path.parent.is_dir():
        return (path,)
    recordings = join_chapters(p for p in path.parent.iterdir() if p.suffix.lower() == path.suffix.lower())
    return next((parts for parts in recordings if parts[0] == path), (path,))


def count_recordings(root: Path) -> int:
    """Count the recordings in a folder and its subfolders. Chapters of a recording count once."""
    folders = [root, *sorted(path for path in root.iterdir() if path.is_dir())]
    found = [list(footage_in(folder).values()) for folder in folders if not is_calibration_folder(folder)]
    return sum(len(join_chapters(paths)) for paths in found)


def join_chapters(videos: Iterable[Path]) -> list[tuple[Path, ...]]:
    """Group the chapters of each recording, in order. Other videos are single recordings."""
    recordings: list[list[Path]] = []
    open_: dict[tuple[str, ...], list[Path]] = {}
    numbered = [(chapter_of(path), path) for path in sorted(videos, key=lambda p: natural_key(p.name))]
    for chapter, path in sorted(numbered, key=lambda item: -1 if item[0] is None else item[0][1]):
        if chapter is None:
            recordings.append([path])
            continue
        key, number = chapter
        begun = open_.get(key)
        if begun is not None and number == (chapter_of(begun[-1]) or (key, 0))[1] + 1:
            begun.append(path)
        else:
            open_[key] = [path]
            recordings.append(open_[key])
    return [tuple(parts) for parts in sorted(recordings, key=lambda parts: natural_key(parts[0].name))]


def chapter_of(path: Path) -> tuple[tuple[str, ...], int] | None:
    """Return the recording and chapter number in the name of a GoPro file, or None for other names."""
    if found := _FIRST.fullmatch(path.stem):
        return (found["head"], "GP", found["number"], found["tail"], path.suffix.lower()), 0
    if found := _CHAPTER.fullmatch(path.stem):
        kind = found["kind"].upper()
        return (found["head"], kind, found["number"], found["tail"], path.suffix.lower()), int(found["chapter"])
    return None


def is_video(path: Path) -> bool:
    """Return whether a path is a video file that is not hidden."""
    return path.suffix.lower() in VIDEOS and path.is_file() and not path.name.startswith(".")


def is_picture(path: Path) -> bool:
    """Return whether a path has an image suffix and is not hidden."""
    return path.suffix.lower() in IMAGES and not path.name.startswith(".")


PICTURES = (".jpg", ".jpeg")
_MOST_EXIF, _MOST_SEGMENTS = 1 << 16, 64  # Largest JPEG segment in bytes, and largest number of segments in a file.
_EXIF_POINTER, _FOCAL_35MM = 0x8769, 0xA405
"""Exif 2.32 tags of the Exif directory and of FocalLengthIn35mmFilm."""
_QUICKTIME_KEY = b"com.apple.quicktime.camera.focal_length.35mm_equivalent"
_SIGNED, _FLOATS = (21, 65, 66, 67, 74), {(23, 4): ">f", (24, 8): ">d"}
_UNSIGNED = (22, 75, 76, 77, 78)
"""Types of big-endian numbers, and types of floats by length in bytes (QuickTime File Format, well-known types)."""
PLAUSIBLE_MM = (8.0, 1000.0)  # Plausible focal lengths in mm, from fisheye to telephoto lenses.


def recorded_focal_mm(footage: Path) -> float | None:
    """Read the 35 mm equivalent focal length in mm from a video or a folder of JPEG images, or return None."""
    if footage.is_dir():
        pictures = sorted(path for path in footage.iterdir() if path.suffix.lower() in PICTURES)
        return recorded_focal_mm(pictures[0]) if pictures else None
    with suppress(*_UNREADABLE), open_regular(footage) as stream:
        found = (_of_jpeg if footage.suffix.lower() in PICTURES else _of_quicktime)(stream)
        if found is not None and math.isfinite(found) and PLAUSIBLE_MM[0] <= found <= PLAUSIBLE_MM[1]:
            return float(found)
    return None


def _of_jpeg(stream: BinaryIO) -> float | None:
    if stream.read(2) != b"\xff\xd8":
        return None
    for _ in range(_MOST_SEGMENTS):
        marker, size = struct.unpack(">HH", stream.read(4))
        content = stream.read(min(size - 2, _MOST_EXIF))
        if marker == 0xFFE1 and content[:6] == b"Exif\0\0":
            return _of_tiff(content[6:])
        if marker == 0xFFDA:  # the image data begins
            return None
    return None


def _of_tiff(data: bytes) -> float | None:
    order = {b"II": "<", b"MM": ">"}.get(data[:2])
    if order is None:
        return None
    pointer = _entry(data, struct.unpack_from(f"{order}I", data, 4)[0], _EXIF_POINTER, order)
    return None if pointer is None else _entry(data, pointer, _FOCAL_35MM, order)


def _entry(data: bytes, at: int, wanted: int, order: str) -> int | None:
    for n in range(struct.unpack_from(f"{order}H", data, at)[0]):
        tag, kind = struct.unpack_from(f"{order}HH", data, at + 2 + 12 * n)
        if tag == wanted and kind in (3, 4):
            return int(struct.unpack_from(f"{order}{'H' if kind == 3 else 'I'}", data, at + 10 + 12 * n)[0])
    return None


def _of_quicktime(stream: BinaryIO) -> float | None:
    whole = memoryview(_top_level_box(stream, b"moov") or b"")
    places = [whole, *(content for kind, content in _boxes(whole) if kind == b"trak")]
    held = (_inside(place, *way) for place in places for way in ((b"meta",), (b"udta", b"meta")))
    return next((mm for meta in held if (mm := _of_metadata(meta)) is not None), None)


def _of_metadata(meta: memoryview) -> float | None:
    meta = meta[4:] if bytes(meta[8:12]) == b"hdlr" else meta  # the ISO box begins with a version, QuickTime's does not
    keys, values = _inside(meta, b"keys"), _inside(meta, b"ilst")
    names = [bytes(name) for _, name in _boxes(keys[8:])]
    if _QUICKTIME_KEY not in names:
        return None
    wanted = struct.pack(">I", 1 + names.index(_QUICKTIME_KEY))
    data = _inside(next((content for kind, content in _boxes(values) if kind == wanted), memoryview(b"")), b"data")
    kind, value = struct.unpack_from(">I", data, 0)[0], bytes(data[8:])
    if kind == 1:
        return float(value.decode("ascii", "replace"))
    if kind in (*_SIGNED, *_UNSIGNED) and 0 < len(value) <= 8:
        return float(int.from_bytes(value, "big", signed=kind in _SIGNED))
    layout = _FLOATS.get((kind, len(value)))
    return None if layout is None else float(struct.unpack(layout, value)[0])
