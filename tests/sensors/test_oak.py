"""OAK cameras: what is asked of a device by a stand-in, replay and pairing by depthai itself where it is installed."""

from __future__ import annotations

import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from solver_backend.cli.main import main
from solver_backend.cli.sensor_verbs import not_recorded
from solver_backend.exchange.diagnostics import sentence
from solver_backend.exchange.errors import (
    BackendMissing,
    CalibrationMissing,
    CommandLineInvalid,
    MocapError,
    OutputExists,
)
from solver_backend.sensors.devices import oak
from solver_backend.sensors.devices.device import Device, PicturesDiffer, SensorFailed, SensorFrame, SensorUnknown
from solver_backend.sensors.devices.oak import (
    ColourFile,
    ColourPicture,
    Oak,
    OakColour,
    OakSettings,
    device_named,
    listed_oaks,
    oak_cameras,
    record_colour,
)
from solver_backend.videos.sync.clocks import read_clocks
from tests.support.fake_depthai import FakeDepthai, Picture
from tests.support.oak_replay import OakReplay

SHAPE = (400, 640)


def pair(number: int, seconds: float, depth_shape: tuple[int, int] = SHAPE) -> dict[str, Picture]:
    rng = np.random.default_rng(number)
    infrared = rng.integers(0, 255, SHAPE).astype(np.uint8)
    depth = rng.integers(0, 5000, depth_shape).astype(np.uint16)
    return {"infrared": Picture(infrared, seconds, number), "depth": Picture(depth, seconds, number)}


@pytest.fixture
def plugged_in(monkeypatch: pytest.MonkeyPatch) -> Callable[..., FakeDepthai]:
    def plug(items: list[Any], **options: Any) -> FakeDepthai:
        module = FakeDepthai(items, **options)
        for place in (oak, oak, oak, oak):
            monkeypatch.setattr(place, "depthai", lambda: module)
        return module

    return plug


def test_a_device_is_set_and_gives_frames(plugged_in: Callable[..., FakeDepthai]) -> None:
    pairs = [pair(n, 100.0 + n / 60) for n in range(3)]
    module = plugged_in(pairs)
    settings = OakSettings(exposure_us=500, iso=150, flood=0.7, sync="slave")
    device = device_named("oak:14442C10=left", settings)
    with device:
        frames = list(device.frames())
    assert device.name == "left"
    assert [f.number for f in frames] == [0, 1, 2]
    assert np.array_equal(frames[2].depth, pairs[2]["depth"].values)
    assert np.array_equal(frames[2].infrared, pairs[2]["infrared"].values)
    assert frames[1].device_s == pytest.approx(100.0 + 1 / 60, abs=1e-6)
    assert frames[2].host_s >= frames[1].host_s > 0
    assert module.asked("setManualExposure") == [(500, 150), (500, 150)]
    assert module.asked("flood") == [(0.7,)] and module.asked("dots") == [(0.0,)]
    assert module.asked("role") == [("slave",)] and module.asked("setRunOnHost") == [(True,)]
    assert module.asked("setDepthAlign") == [("left",)]
    assert module.closed == 1
    assert listed_oaks() == ["14442C10"]
    device.close()
    assert module.closed == 1


def test_stamps_of_ptp_are_the_systems(plugged_in: Callable[..., FakeDepthai]) -> None:
    plugged_in([pair(0, 100.0)])
    device = Oak("a", "1", OakSettings(sync="ptp"))
    with device:
        assert [f.device_s for f in device.frames()] == [pytest.approx(5100.0, abs=1e-5)]


@pytest.mark.parametrize(
    ("items", "options", "error", "words"),
    [
        ([], {"there": False}, SensorFailed, "cannot be opened"),
        ([], {"sockets": ("a",)}, SensorUnknown, "no pair of mono"),
        ([], {"flood": False}, SensorUnknown, "flood"),
        ([], {"roles": False}, SensorFailed, "no such pin"),
        ([], {"ends": False}, SensorFailed, "No frame arrived"),
        ([pair(0, 1.0), RuntimeError("X_LINK_ERROR")], {}, SensorFailed, "was lost"),
        ([pair(0, 5.0), pair(1, 4.0)], {}, SensorFailed, "jumped from 5.000 to 4.000"),
        ([pair(0, 5.0), pair(1, 50.0)], {}, SensorFailed, "jumped"),
        ([pair(0, 5.0, (200, 320))], {}, PicturesDiffer, "320 x 200"),
    ],
    ids=["not there", "unknown", "no flood", "no wire", "silent", "unplugged", "clock back", "clock on", "sizes"],
)
def test_what_can_go_wrong_is_named(
    plugged_in: Callable[..., FakeDepthai], items: list, options: dict, error: type[MocapError], words: str
) -> None:
    module = plugged_in(items, **options)
    device = Oak("left", "14442C10", OakSettings(sync="master", silent_s=0.05))
    with pytest.raises(error, match=words) as caught:  # noqa: PT012
        device.open()
        list(device.frames())
    assert "left" in caught.value.where
    device.close()
    assert module.closed == (0 if not module.there else 1)


def test_lenses_are_the_devices_own_and_their_lack_is_named(plugged_in: Callable[..., FakeDepthai]) -> None:
    module = plugged_in([])
    cameras = oak_cameras([Oak("a", "1"), Oak("b", "2", OakSettings(fps=30.0, size=(1280, 800)))])
    assert cameras.names == ("a", "b") and cameras.image_size.tolist() == [[640, 400], [1280, 800]]
    assert cameras.K[:, 0, 2].tolist() == [320.0, 640.0]
    assert module.closed == 2
    plugged_in([], sockets=("a",))
    with pytest.raises(CalibrationMissing, match="no factory calibration"):
        oak_cameras([Oak("a", "1")])
    plugged_in([], there=False)
    with pytest.raises(SensorFailed, match="cannot be opened"):
        oak_cameras([Oak("a", "1")])


def test_a_device_can_be_sent_to_the_process_that_opens_it() -> None:
    device = Oak("a", "1", OakSettings(fps=30.0))
    assert pickle.loads(pickle.dumps(device)) == device


def test_names_on_the_command_line_are_told_apart(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    for verb in ("sensors record", "sensors colour"):
        assert main([verb, str(tmp_path / "x"), "--oak", "1=a", "--oak", "2=a"]) == 2
        assert main([verb, str(tmp_path / "x"), "--oak", "1=a", "--seconds", "0"]) == 2
        assert main([verb, str(tmp_path / "x"), "--oak", "kinect:1"]) == 3
    assert "Two cameras have the same name" in capsys.readouterr().err
    assert not (tmp_path / "x").exists()


def test_impossible_settings_and_kinds_are_named() -> None:
    for options in ({"sync": "sun"}, {"size": (3, 4)}, {"flood": 2.0}, {"exposure_us": 20_000}, {"fps": 1000.0}):
        with pytest.raises(CommandLineInvalid):
            OakSettings(**options)
    for text in ("kinect:1", "oak", "oak:", ""):
        with pytest.raises(SensorUnknown):
            device_named(text)
    with pytest.raises(SensorFailed, match="not open"):
        next(Oak("a", "1").frames())


def test_depthai_that_is_missing_or_old_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def missing(name: str) -> Any:
        raise ImportError(name)

    monkeypatch.setattr(oak, "import_module", missing)
    with pytest.raises(BackendMissing, match=r"not installed"):
        listed_oaks()
    assert main(["sensors list"]) != 0
    assert "pip install depthai" in capsys.readouterr().err
    old = FakeDepthai([])
    old.__version__ = "2.30.0"
    monkeypatch.setattr(oak, "import_module", lambda name: old)
    with pytest.raises(BackendMissing, match=r"2\.30\.0 is installed"):
        listed_oaks()


class Prepared(Device):
    """A sensor of frames that are made here."""

    name = "left"

    def __init__(self, kind: type, lost: tuple[int, ...] = ()) -> None:
        rng = np.random.default_rng(0)
        self.made = [
            SensorFrame(
                "left", rng.integers(0, 255, SHAPE).astype(kind),
                None if n in lost else rng.integers(0, 5000, SHAPE).astype(np.uint16), 100.0 + n / 60, 0.0, n,
            )
            for n in range(40)
        ]  # fmt: skip

    def frames(self) -> Iterator[SensorFrame]:
        yield from self.made


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_a_replay_goes_through_depthais_nodes_unchanged(kind: type) -> None:
    if find_spec("depthai") is None:
        pytest.skip("depthai is not installed: pip install depthai")
    source = Prepared(kind, lost=(7, 20))
    device = OakReplay(source, 60.0)
    with device:
        frames = list(device.frames())
    # A picture whose partner was lost is no frame.
    assert [f.number for f in frames] == [n for n in range(40) if n not in (7, 20)]
    for frame in frames:
        made = source.made[frame.number]
        assert np.array_equal(frame.infrared, made.infrared) and frame.infrared.dtype == kind
        assert np.array_equal(frame.depth, made.depth)
        assert frame.device_s == pytest.approx(made.device_s, abs=2e-6)
    device.close()


def test_depthai_leaves_signals_and_standard_output_alone() -> None:
    if find_spec("depthai") is None:
        pytest.skip("depthai is not installed: pip install depthai")
    program = (  # without signals 32 and 33, which the C library keeps for its threads
        "mask = lambda: next(l.split()[1] for l in open('/proc/self/status') if l.startswith('SigIgn'))\n"
        "ignored = lambda: int(mask(), 16) & ~(3 << 31)\n"
        "was = ignored()\n"
        "from solver_backend.sensors.devices.oak import listed_oaks\n"
        "listed_oaks()\n"
        "assert ignored() == was\n"
    )
    if not Path("/proc/self/status").is_file():
        pytest.skip("signals are told by /proc, which this system has not got")
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout) == (0, ""), done.stderr


def jpegs(count: int, offset_s: float, seed: int) -> list[ColourPicture]:
    cv2 = pytest.importorskip("cv2")
    rng = np.random.default_rng(seed)
    small = rng.integers(0, 255, (count, 9, 16, 3), dtype=np.uint8)
    pictures = [np.kron(p, np.ones((20, 20, 1), np.uint8)) for p in small]
    return [
        ColourPicture(cv2.imencode(".jpg", p[..., ::-1])[1].tobytes(), 50.0 + offset_s + n / 60)
        for n, p in enumerate(pictures)
    ]


class Filmed:
    """A source of pictures with pauses."""

    def __init__(self, pictures: list[ColourPicture]) -> None:
        self._pictures = pictures

    def pictures(self) -> Iterator[ColourPicture | None]:
        for picture in self._pictures:
            yield None
            yield picture


def test_colour_of_several_cameras_begins_with_one_exposure_and_is_read_by_the_road(tmp_path: Path) -> None:
    pytest.importorskip("av")
    from solver_backend.videos.files.video import probe, read_pictures

    # The second one is started three frames later and exposes 0.2 ms later.
    first, second = jpegs(60, 0.0, 0), jpegs(60, 3 / 60 + 0.0002, 1)
    del first[13]
    counts = record_colour({"a": Filmed(first), "b": Filmed(second)}, tmp_path, (320, 180), 60.0, 0.5)
    assert counts == {"a": 29, "b": 30}
    seen = {name: list(read_pictures(probe(tmp_path / f"{name}.mp4"))) for name in "ab"}
    times = {name: np.array([p.time_s for p in pictures]) for name, pictures in seen.items()}
    # The picture that was lost is lost at its own time.
    assert np.allclose(times["a"] - times["a"][0], np.delete(np.arange(30), 10) / 60, atol=2e-4)
    assert np.allclose(times["b"] - times["b"][0], np.arange(30) / 60, atol=2e-4)
    clocks = read_clocks(tmp_path / "clocks.json")
    assert clocks.names == ("a", "b") and clocks.offset_s == pytest.approx([0.0, -0.0002], abs=1e-9)
    cv2 = pytest.importorskip("cv2")
    wanted = cv2.imdecode(np.frombuffer(first[3].jpeg, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    assert np.abs(seen["a"][0].rgb.astype(int) - wanted).mean() < 4.0
    with pytest.raises(OutputExists):
        record_colour({"a": Filmed(first)}, tmp_path, (320, 180), 60.0, 0.5)
    with pytest.raises(SensorFailed, match="not sending images"):
        record_colour({"c": Filmed([])}, tmp_path, (320, 180), 60.0, 0.5)


def test_colour_that_is_cut_off_can_be_read_up_to_there(tmp_path: Path) -> None:
    pytest.importorskip("av")
    from solver_backend.videos.files.video import probe

    whole = tmp_path / "whole.mp4"
    file = ColourFile(whole, (320, 180), 60.0, 50.0)
    for picture in jpegs(40, 0.0, 0):
        file.add(picture)
    file.close()
    assert file.count == 40
    cut = tmp_path / "cut.mp4"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    assert 10 <= probe(cut).num_frames <= 30


def test_the_colour_camera_is_set_and_its_loss_is_named(plugged_in: Callable[..., FakeDepthai]) -> None:
    module = plugged_in([Picture(b"jpeg", 3.0), None, RuntimeError("gone")])
    camera = OakColour("a", "1", role="master")
    with camera:
        found = camera.pictures()
        assert next(found) == ColourPicture(b"jpeg", 3.0)
        assert next(found) is None
        with pytest.raises(SensorFailed, match="was lost"):
            next(found)
    assert module.asked("role") == [("master",)] and module.asked("setManualExposure") == [(4000, 800)]
    assert module.closed == 1


def test_a_camera_of_which_no_frame_was_recorded_is_named() -> None:
    (found,) = not_recorded({"left": 60, "right": 0})
    assert sentence(found).startswith("Sensor right is not delivering data: no frame of it was recorded")
    assert not not_recorded({"left": 60, "right": 1})
