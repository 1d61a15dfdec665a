"""Read and write video files with PyAV: time stamps, images, sound and hashes."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from solver_backend.exchange.errors import BackendMissing, MocapError
from solver_backend.exchange.outputs import atomic_output
from solver_backend.io.footage import parts_of

if TYPE_CHECKING:
    from av.container import InputContainer


class VideoUnreadable(MocapError):
    """The video is missing, empty or damaged, or the file is not a video."""


class VideoWithoutSound(MocapError):
    """A video without sound cannot be synchronised by sound."""


class SameVideoTwice(MocapError):
    """Two cameras use the same video."""


AGAIN = "Copy the file from the camera again, or omit this camera."


@contextmanager
def opened(path: Path) -> Iterator[InputContainer]:
    """Open a video file with PyAV. Raise ``VideoUnreadable`` if that fails."""
    av = library()
    if not path.is_file():
        raise VideoUnreadable("There is no such video.", where=str(path), hint="Check the path.")
    if path.stat().st_size == 0:
        raise VideoUnreadable("The video is empty: its file has no bytes.", where=str(path), hint=AGAIN)
    try:
        with av.open(str(path)) as container:
            yield container
    except av.error.FFmpegError as error:
        hint = f"It may have been truncated while being recorded or copied. {AGAIN}"
        raise VideoUnreadable(f"The video cannot be read: {error.strerror}.", where=str(path), hint=hint) from error


def video_stream(container: InputContainer) -> Any:
    """Return the first video stream. Raise ``VideoUnreadable`` if there is none."""
    if not container.streams.video:
        message = "The file contains no images, only sound or data."
        raise VideoUnreadable(message, where=str(container.name), hint="Choose a file with images.")
    return container.streams.video[0]


def library() -> Any:
    """Import PyAV. Raise ``BackendMissing`` if it is not installed."""
    try:
        import av
        import av.error
        import av.logging
    except ModuleNotFoundError as error:
        message = "Reading videos needs PyAV, which is not installed."
        raise BackendMissing(message, hint="Install it with: pip install av.") from error
    av.logging.set_level(None)
    return av


OFF_SHARE = 0.2  # Largest relative deviation from the median at which an interval counts for the frame rate.


class TimedPictures:
    """Base class for images with presentation times."""

    times_s: np.ndarray

    @property
    def num_frames(self) -> int:
        """Number of images."""
        return len(self.times_s)

    @property
    def fps(self) -> float:
        """Frame rate in 1/s (see ``rate_of``)."""
        return rate_of(self.times_s)


@dataclass(frozen=True)
class VideoInfo(TimedPictures):
    """Properties of a source with F images: a video, a recording in chapters, or an image folder."""

    path: Path  # The file, the first of several chapters, or the folder of images.
    size: tuple[int, int]  # Width and height in pixels after rotation, as displayed.
    # pyrefly: ignore[bad-override] - the base class declares what both subclasses have
    times_s: np.ndarray  # (F,) increasing presentation times on the file's clock, in seconds.
    parts: tuple[Path, ...] = ()  # Files in order, see ``parts_of``. Empty if there is only one.
    timed: bool = True  # True if each decoded image has its own time. Otherwise, ``times_s`` applies in order.
    stored: tuple[int, int] = (0, 0)  # Stored size (px) after rotation. Differs from ``size`` if pixels are not square.


UNTIMED_SHARE = 0.5  # Largest fraction of distinct times in a file that does not store image times.
LONGEST_GAP_S, RARE_GAP = 60.0, 100.0  # Longest time without an image, in s and in median intervals. Chosen by hand.
PICTURES_FPS = 30.0  # Frame rate assumed for a folder of images, in 1/s.


def probe(path: Path | str, pictures_fps: float = PICTURES_FPS) -> VideoInfo:
    """Read the properties of a video, of a recording in chapters, or of an image folder.

    The packets are counted, and only the first image is decoded.
    """
    path = Path(path)
    parts = parts_of(path)
    if path.is_dir():
        if not parts:
            raise VideoUnreadable("The folder contains no images.", where=str(path), hint="Check the path.")
        first = _probe_file(parts[0])
        return replace(first, path=path, times_s=np.arange(len(parts)) / pictures_fps, parts=parts)
    first, *others = (_probe_file(part) for part in parts)
    if any(item.size != first.size for item in others):
        raise VideoUnreadable("The chapters have different sizes.", where=str(path), hint="Split the recordings.")
    times = [first.times_s]
    for item in others:
        times.append(item.times_s - item.times_s[0] + times[-1][-1] + 1.0 / max(first.fps, 1.0))
    return replace(first, times_s=np.concatenate(times), parts=parts if others else ())


def _probe_file(path: Path) -> VideoInfo:
    with opened(path) as container:
        stream = video_stream(container)
        base = stream.time_base
        stated = float(stream.codec_context.framerate or stream.base_rate or 0.0)
        is_avi = container.format.name == "avi"
        packets = [(packet.pts, packet.dts) for packet in container.demux(stream) if packet.size]
    stamps = [pts for pts, _ in packets if pts is not None]
    if packets and not stamps:
        hint = "Put the frames in a container with their frame rate: ffmpeg -r 30 -i VIDEO -c copy VIDEO.mp4."
        raise VideoUnreadable("The file contains frames without timestamps.", where=str(path), hint=hint)
    if not stamps:
        raise VideoUnreadable("The video contains no frames.", where=str(path), hint=AGAIN)
    with opened(path) as container:
        stream = video_stream(container)
        first, aspect = next(container.decode(stream), None), pixel_aspect(stream)
    if first is None:
        raise VideoUnreadable("No frame of the video can be decoded.", where=str(path), hint=AGAIN)
    size, stored = (round(first.width * aspect), first.height), (first.width, first.height)
    if quarter_turn(first.rotation) % 180:
        size, stored = size[::-1], stored[::-1]
    times = np.unique(np.array(stamps, dtype=np.float64)) * float(base)
    if len(times) <= UNTIMED_SHARE * len(stamps) and stated > 0:
        return VideoInfo(path, size, np.arange(len(stamps)) / stated, timed=False, stored=stored)
    if is_avi and any(pts != dts for pts, dts in packets):  # AVI files store times in decoding order
        places = np.unique(np.array([dts for _, dts in packets if dts is not None], dtype=np.float64)) * float(base)
        if len(places) < len(packets):
            places = np.arange(len(packets)) / max(rate_of(times), 1.0)
        return VideoInfo(path, size, times[0] + places - places[0], timed=False, stored=stored)
    gaps = np.diff(times)
    if len(gaps) and gaps.max() > LONGEST_GAP_S and gaps.max() > RARE_GAP * np.median(gaps):
        number = int(gaps.argmax())
        message = f"After frame {number}, the video has no frames for {gaps[number]:.0f} s."
        raise VideoUnreadable(message, where=str(path), hint="Cut the video there, and solve the parts as two takes.")
    return VideoInfo(path, size, times, stored=stored)


def rate_of(times_s: np.ndarray) -> float:
    """Return the mean frame rate in 1/s of increasing times, ignoring gaps. Return 0 for fewer than two times."""
    if len(times_s) < 2:
        return 0.0
    gaps = np.diff(times_s)
    usual = float(np.median(gaps))
    return float(1.0 / gaps[np.abs(gaps - usual) <= OFF_SHARE * usual].mean())


SQUARE, LARGEST_ASPECT = 0.02, 4.0
"""Relative tolerance within which pixels count as square, because encoders crop images to whole blocks. Largest pixel
aspect ratio: a file that states a more extreme ratio is damaged. Chosen by hand."""


def pixel_aspect(stream: Any) -> Fraction:
    """Return the width-to-height ratio of the stored pixels, or 1 if they are square or the ratio is implausible."""
    aspect = stream.sample_aspect_ratio or Fraction(1)
    plausible = abs(aspect - 1) > SQUARE and 1 / LARGEST_ASPECT <= aspect <= LARGEST_ASPECT
    return aspect if plausible else Fraction(1)


def quarter_turn(degrees: float) -> int:
    """Round an angle to the nearest of 0, 90, 180 and 270 degrees."""
    return round(degrees / 90.0) * 90 % 360


LOST_SHARE = 0.02  # Largest fraction of damaged images in a usable video.


@dataclass(frozen=True)
class Picture:
    """An image from a video."""

    number: int  # Index in presentation order.
    time_s: float  # Presentation time on the file's clock.
    rgb: np.ndarray  # (H, W, 3) uint8 image after rotation.


def read_pictures(info: VideoInfo) -> Iterator[Picture]:
    """Decode the images of a video one by one. Damaged images are skipped, and the remaining images keep their times.

    Raises:
        VideoUnreadable: more than ``LOST_SHARE`` of the images are damaged or missing, or the image size changes.
    """
    number = 0
    for time_s, rgb in _timed_pictures(info):
        if rgb.shape[1::-1] != info.size:
            first, now = ("{} x {}".format(*size) for size in (info.size, rgb.shape[1::-1]))
            message = f"Picture {number} has {now} pixels, but the first one has {first}."
            hint = "Cut the recording where its size changes, and solve the parts as two takes."
            raise VideoUnreadable(message, where=str(info.path), hint=hint)
        yield Picture(number, time_s, rgb)
        number += 1
    # The last image of a truncated recording may be damaged.
    if number < 1 or number + 1 < (1.0 - LOST_SHARE) * info.num_frames:
        message = f"Only {number} of the video's {info.num_frames} frames can be decoded."
        raise VideoUnreadable(message, where=str(info.path), hint=AGAIN)


def _timed_pictures(info: VideoInfo) -> Iterator[tuple[float, np.ndarray]]:
    if info.path.is_dir():
        for part, time_s in zip(info.parts, info.times_s.tolist(), strict=True):
            yield from ((time_s, picture()) for _, picture in decoded_pictures(part))
        return
    gap_s, count = 1.0 / max(info.fps, 1.0), 0
    late_s = last_s = 0.0
    for part in info.parts or (info.path,):
        begun = count
        for decoded in _decoded(part):
            if decoded is None:
                count += not info.timed
                continue
            time_s, picture = decoded
            if begun and count == begun:
                late_s = last_s + gap_s - time_s
            last_s = time_s + late_s if info.timed else float(info.times_s[min(count, info.num_frames - 1)])
            yield last_s, picture()
            count += 1


Decoded = tuple[float, Callable[[], np.ndarray]]  # Time of an image in s, and a function that returns its pixels.


def decoded_pictures(path: Path) -> Iterator[Decoded]:
    """Decode a video file. Yield each image's time (s) and a function that returns the image (H, W, 3) uint8.

    Images are rotated upright and scaled to square pixels, as a player displays them. Damaged images are skipped.
    """
    return (decoded for decoded in _decoded(path) if decoded is not None)


def _decoded(path: Path) -> Iterator[Decoded | None]:
    """Yield the same as ``decoded_pictures``, and None for each damaged image."""
    av = library()
    with opened(path) as container:
        stream = video_stream(container)
        stream.thread_type = "AUTO"
        # Use one converter per file, because creating one per image takes longer than the conversion.
        convert, aspect = av.video.reformatter.VideoReformatter().reformat, pixel_aspect(stream)
        for packet in container.demux(stream):
            try:
                frames = packet.decode()
            except av.error.InvalidDataError:
                yield None
                continue
            for frame in frames:
                broken = frame.time is None or frame.is_corrupt
                yield None if broken else (float(frame.time), partial(_picture, convert, frame, aspect))


def _picture(convert: Callable[..., Any], frame: Any, aspect: Fraction) -> np.ndarray:
    rgb = convert(frame, width=round(frame.width * aspect), height=frame.height, format="rgb24").to_ndarray()
    turns = quarter_turn(frame.rotation) // 90
    return np.ascontiguousarray(np.rot90(rgb, turns)) if turns else rgb


_PIECE = 1 << 22  # Number of bytes per read. Chosen by hand.


def file_hash(path: Path | str) -> str:
    """Return the 16-byte BLAKE2b hash of a file in hexadecimal."""
    digest = hashlib.blake2b(digest_size=16)
    with open(path, "rb") as stream:
        while piece := stream.read(_PIECE):
            digest.update(piece)
    return digest.hexdigest()


def recording_hash(parts: Sequence[Path]) -> str:
    """Return the hash of all files of a recording, in order."""
    if len(parts) == 1:
        return file_hash(parts[0])
    return hashlib.blake2b("".join(map(file_hash, parts)).encode(), digest_size=16).hexdigest()


def require_different(hashes: Mapping[Path, str]) -> None:
    """Raise ``SameVideoTwice`` if two videos consist of the same bytes."""
    first: dict[str, Path] = {}
    for path, digest in hashes.items():
        if digest in first:
            message = f"{first[digest].name} and {path.name} are the same video."
            hint = "Copy the second camera's video again, because two cameras cannot film identical images."
            raise SameVideoTwice(message, where=str(path), hint=hint)
        first[digest] = path


RATE_HZ = 16_000  # Sample rate of the sound in Hz.
SILENCE = 1e-5  # Largest RMS value that counts as silence, where full scale is 1. Chosen by hand.


@dataclass(frozen=True)
class Sound:
    """Mono sound track of a video."""

    samples: np.ndarray  # (N,) float32 samples, where full scale is 1.
    start_s: float  # Time of the first sample on the clock of the images, in seconds.
    rate_hz: int = RATE_HZ


def read_sound(path: Path | str) -> Sound:
    """Read a video's sound track in mono. Raise ``VideoWithoutSound`` if it is missing or silent."""
    path, parts, start = Path(path), [], None
    hint = "Film with the microphone on, or synchronise by keypoints."
    with opened(path) as container:
        if not container.streams.audio:
            raise VideoWithoutSound("The video has no sound.", where=str(path), hint=hint)
        resampler = library().AudioResampler(format="flt", layout="mono", rate=RATE_HZ)
        for frame in container.decode(container.streams.audio[0]):
            start = frame.time if start is None else start
            parts += [piece.to_ndarray()[0] for piece in resampler.resample(frame)]
        if parts:
            parts += [piece.to_ndarray()[0] for piece in resampler.resample(None)]
    samples = np.concatenate(parts).astype(np.float32) if parts else np.zeros(0, np.float32)
    if not len(samples) or float(np.sqrt(np.mean(samples.astype(np.float64) ** 2))) < SILENCE:
        raise VideoWithoutSound("The video has a silent sound track.", where=str(path), hint=hint)
    return Sound(samples, float(start or 0.0), RATE_HZ)


def write_video(path: Path | str, pictures: Iterable[np.ndarray], fps: float, *, overwrite: bool = False) -> int:
    """Write images (H, W, 3) uint8 as H.264 in MP4. Return the number of images."""
    av, count = library(), 0
    with atomic_output(path, overwrite=overwrite) as temporary, av.open(str(temporary), "w", format="mp4") as container:
        stream = None
        for rgb in pictures:
            height, width = (n - n % 2 for n in rgb.shape[:2])
            if stream is None:
                stream = container.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001))
                stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
                stream.options = {"crf": "23", "preset": "veryfast"}
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(rgb[:height, :width]), format="rgb24")
            container.mux(stream.encode(frame))
            count += 1
        if stream is not None:
            container.mux(stream.encode())
    return count
