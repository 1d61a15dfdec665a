"""The zip that includes a detector without a window, a network, or another Python: from videos to a body.

``python offline.py ZIP VIDEOS`` with a Python that has Blender's module and NumPy alone, or
``blender --background --factory-startup --python offline.py -- ZIP VIDEOS``. ``BLENDER_USER_RESOURCES`` names an empty
folder. Its last line is what it found, as JSON.
"""

from __future__ import annotations

import importlib.util
import json
import shutil
import socket
import sys
from pathlib import Path

import bpy

_FINGER = "left_index2"


def play(archive: Path, videos: Path) -> dict[str, object]:
    """Install the zip, import the videos, solve, and return what is on the timeline."""
    found: dict[str, object] = {"blender": bpy.app.version_string, "python": sys.version.split()[0]}
    found["other_python"] = shutil.which("python3") or shutil.which("python") or ""
    found["network"] = network()
    found["already_installed"] = [name for name in ("av", "cv2", "ai_edge_litert") if importlib.util.find_spec(name)]
    install = bpy.ops.extensions.package_install_files
    assert install(filepath=str(archive), repo="user_default", enable_on_install=True) == {"FINISHED"}
    scene = bpy.context.scene
    assert bpy.ops.mocap.capture_from_videos(filepath=str(sorted(videos.glob("*.mp4"))[0])) == {"FINISHED"}
    assert scene.mocap.capture.file, f"no capture: {_error()}"
    assert bpy.ops.mocap.solve() == {"FINISHED"} and scene.mocap.review.armature, f"no take: {_error()}"
    body = scene.mocap.review.armature
    bends = []
    for frame in range(scene.frame_start, scene.frame_end + 1):
        scene.frame_set(frame)
        bends.append(body.pose.bones[_FINGER].matrix_basis.to_quaternion().angle)
    found |= {"frames": len(bends), "bones": len(body.pose.bones), "finger_rad": max(bends) - min(bends)}
    found["packages"] = importlib.util.find_spec("ai_edge_litert").origin
    return found


def network() -> str:
    """Return why no address can be reached, "" if one can."""
    try:
        socket.create_connection(("127.0.0.1", 9), 1.0).close()
    except ConnectionRefusedError:
        return ""  # the machine's own address answers: its network is on
    except OSError as error:
        return error.strerror or str(error)
    return ""


def _error() -> object:
    name = "bl_ext.user_default.manifold_mocap.ui.operators.base"
    last = sys.modules[name].current.last
    return None if last is None else last.error


if __name__ == "__main__":
    words = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    sys.stdout.write(json.dumps(play(Path(words[0]), Path(words[1]))) + "\n")
