"""Sixty mistakes of new users: each answer names the mistake and the way out, and nothing is written."""

from __future__ import annotations

import io
from pathlib import Path

import pytest

from blender_addon.headless.main import main as blender
from solver_backend.cli.main import main
from solver_backend.exchange.command import Report
from solver_backend.exchange.errors import FileMissing
from tests.support.scenes import small_capture, small_motion

FOLDERS = ("footage", "one_video", "pictures", "empty")
ANSWERS: tuple[tuple[str, str, str], ...] = (
    # The verb.
    ("", "VERB is missing", "--help lists the verbs"),
    ("slove", "no verb 'slove'", "Did you mean solve?"),
    ("from-video footage", "no verb 'from-video'", "Did you mean from-videos?"),
    ("calibrate-cameras footage", "no verb 'calibrate-cameras'", "cameras calibrate"),
    ("calibrate take.c3d", "no verb 'calibrate'", "cameras calibrate, markers calibrate"),
    ("detect walk.mp4", "no verb 'detect'", "cameras detect"),
    ("export motion.npz", "no verb 'export'", "markers export"),
    ("cameras", "VERB is missing", "cameras --help"),
    ("cameras calibrat footage", "no verb 'cameras calibrat'", "cameras calibrate"),
    ("live take.c3d", "no verb 'live take.c3d'", "live needs one of its verbs"),
    ("solve take.npz --help-al", "--help-al", "--help-all"),
    # What is solved.
    ("solve", "needs a capture and --out", "solve CAPTURE --out MOTION.npz"),
    ("solve capture.npz", "needs a capture and --out", "solve CAPTURE --out MOTION.npz"),
    ("solve walk.mp4 -o m.npz", "is a video", "from-videos walk.mp4"),
    ("solve footage -o m.npz", "contains videos", "from-videos"),
    ("solve one_video -o m.npz", "one camera's images, but no detections", "from-videos one_video"),
    ("solve photo.jpg -o m.npz", "is an image", "from-videos"),
    ("solve captur.npz -o m.npz", "no such file or folder", "capture.npz?"),
    ("solve nowhere/take.npz -o m.npz", "no such file or folder", "no folder"),
    ("solve empty -o m.npz", "it is empty", "Captures are"),
    ("solve notes.txt -o m.npz", "not a readable capture", "Captures are"),
    ("solve empty.npz -o m.npz", "truncated", "Copy or export it again"),
    ("solve walk.fbx -o m.npz", "a skeleton motion", "motion convert"),
    ("solve take.tak -o m.npz", "OptiTrack Motive", "Export C3D"),
    ("solve motion.npz -o m.npz", "is a Manifold MoCap motion", "read motions"),
    ("solve capture.npz footage -o m.npz", "Unrecognized arguments: footage", "Usage: solve [CAPTURE]"),
    ("solve capture.npz -o m.npz --person Anna", "no person 'Anna'", "Omit the name"),
    # Where the result goes.
    ("solve capture.npz -o", "--out: expected one argument", "--out MOTION.npz"),
    ("solve capture.npz -o m.bvh", "must end in .npz", "m.bvh.npz"),
    ("solve capture.npz -o capture.npz", "must be different files", "another name"),
    ("solve capture.npz -o motion.npz", "already exist", "--overwrite"),
    ("solve capture.npz -o m.npz --report page.pdf", "must end in .html", "--report PAGE.html"),
    ("convert capture.npz", "-o/--out is missing", "Usage: convert CAPTURE"),
    ("convert capture.npz -o x", "must end in .npz", "--out x.npz"),
    ("markers label take.c3d -o labels.txt", "must end in", "--out"),
    # Numbers and names.
    ("solve capture.npz -o m.npz --stature 1,78", "'1,78' is not a number; write 1.78", "--stature"),
    ("solve capture.npz -o m.npz --stature 178", "0 to 2.6 m", "in metres: 1.78"),
    ("solve capture.npz -o m.npz --stature 1780", "0 to 2.6 m", "in metres: 1.78"),
    ("solve capture.npz -o m.npz --fps fast", "'fast' is not a number", "--fps"),
    ("solve capture.npz -o m.npz --frames 10", "expected 2 arguments", "--frames FIRST LAST"),
    ("solve capture.npz -o m.npz --frames a b", "'a' is not a whole number", "--frames FIRST LAST"),
    ("solve capture.npz -o m.npz --frames 10 5", "frames = (10, 5) is not valid", "First and last frame"),
    ("solve capture.npz -o m.npz --method best", "one of global", "Frames that are solved together"),
    ("solve capture.npz -o m.npz --preset best", "'best' is unknown. Known: fast, balanced", "--preset"),
    ("solve capture.npz -o m.npz --smothing 3", "--smothing", "Did you mean --smoothing?"),
    ("solve capture.npz -o m.npz --body nobody", "Unknown body 'nobody'", "body file"),
    ("solve capture.npz -o m.npz --offset cam01", "is not CAMERA=FRAMES", "cam02=60"),
    ("explain camera_turnd", "no code 'camera_turnd'", "camera_turned"),
    # Videos, boards and detectors.
    ("from-videos foot", "no such folder", "videos"),
    ("from-videos empty", "does not contain a take", "one video per camera"),
    ("from-videos footage --dry-run --board nonsense", "The number of columns and rows", "charuco:5x7:35mm"),
    ("from-videos footage --dry-run --detector gone.onnx", "no such model", "Check the path"),
    ("cameras detect wal.mp4 -o c.npz", "no such video", "walk.mp4?"),
    ("cameras board a4 -o b.pdf", "The number of columns and rows", "charuco:5x7:35mm"),
    ("cameras board charuco:5x7:35mm -o b.png", "must end in .pdf or .svg", "--out"),
    ("cameras calibrate footage -o c.toml", "calibration board is unknown", "--board charuco"),
    # Motions, markers and Blender.
    ("evaluate capture.npz", "MOTION.npz is missing", "Usage: evaluate CAPTURE"),
    ("evaluate capture.npz motio.npz", "no such file", "motion.npz?"),
    ("motion denoise capture.npz out.npz", "is a capture, but a Manifold MoCap motion is expected", "read captures"),
    ("hands add motio.npz gloves.bvh -o m.npz", "no such file", "motion.npz?"),
    ("markers label capture.npz -o l.c3d", "no markers to label", "C3D"),
    ("blender bake", "MOTION.npz, -o/--out are missing", "Usage: blender bake"),
    ("blender bak motion.npz", "no verb 'bak'", "Did you mean bake?"),
    ("blender body -o body.npz", "must end in .blend", "--out FILE.blend"),
    ("blender bake motion.npz -o out --fps 0", "above 0", "--fps N"),
    ("blender export motion.npz --format fbxx -o out", "'fbxx' is unknown", "Did you mean fbx?"),
    ("blender retarget motion.npz -o o.blend", "--target is missing", "Usage: blender retarget"),
    ("blender batch nowhere -o out", "no such folder", "Specify the capture folder"),
)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from solver_backend.io.native.capture_file import write_capture
    from solver_backend.io.native.motion_file import write_motion

    folder = tmp_path_factory.mktemp("mistakes")
    for name in FOLDERS:
        (folder / name).mkdir()
    for name in ("footage/cam01.mp4", "footage/cam02.mp4", "one_video/cam01.mp4", "walk.mp4"):
        (folder / name).write_bytes(b"\0\0\0 ftypisom")
    for name in ("photo.jpg", "notes.txt", "empty.npz", "walk.fbx", "take.tak", "take.c3d"):
        (folder / name).write_bytes(b"")
    write_capture(folder / "capture.npz", small_capture(8))
    write_motion(folder / "motion.npz", small_motion(2))
    return folder


@pytest.mark.parametrize(("line", "mistake", "way_out"), ANSWERS, ids=[line or "nothing" for line, *_ in ANSWERS])
def test_an_answer_names_the_mistake_and_the_way_out(
    line: str, mistake: str, way_out: str, files: Path, monkeypatch: pytest.MonkeyPatch, capfd
) -> None:
    monkeypatch.chdir(files)
    before = sorted(path.name for path in files.rglob("*"))
    words = line.split()
    run, words = (blender, words[1:]) if words[:1] == ["blender"] else (main, words)
    assert run(words, *(["blender"] if run is blender else [])) in (2, 3)
    answer = capfd.readouterr().err.split("error: ", 1)[1].replace("manifold ", "")
    said, _, hint = answer.partition("\n  try:   ")
    assert mistake in said and "Traceback" not in answer
    assert way_out in hint, answer
    assert sorted(path.name for path in files.rglob("*")) == before


def test_there_are_sixty() -> None:
    assert len(ANSWERS) >= 60


def test_colours_are_for_terminals(monkeypatch: pytest.MonkeyPatch) -> None:
    def shown(is_terminal: bool) -> str:
        stream = io.StringIO()
        stream.isatty = lambda: is_terminal  # type: ignore[method-assign]
        Report(io.StringIO(), stream, as_json=False).error(FileMissing("Gone.", hint="Look."))
        return stream.getvalue()

    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert shown(True).startswith("\n\033[1;31merror:\033[0m Gone.") and "\033" not in shown(False)
    monkeypatch.setenv("NO_COLOR", "1")
    assert "\033" not in shown(True)
