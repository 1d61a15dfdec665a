"""Bake a motion into a .blend without a window.

    python docs/examples/bake_headless.py MOTION.npz CAPTURE.npz FOLDER

Needs Blender's Python module (``bpy``). The add-on is a program of its own that reports its progress, one JSON object a
line.
"""

import json
import subprocess
import sys


def main(motion_path: str, capture_path: str, folder: str) -> None:
    """Run the add-on's bake and print what it wrote."""
    command = [sys.executable, "-m", "blender_addon", "bake", motion_path, "--capture", capture_path, "--out", folder]
    done = subprocess.run([*command, "--no-pictures", "--json"], capture_output=True, text=True)
    event = json.loads(done.stdout.strip().splitlines()[-1])
    if done.returncode != 0:
        sys.exit(f"{event['message']} {event['where']} {event['hint']}")
    print(json.dumps(event, indent=2))


if __name__ == "__main__":
    main(*sys.argv[1:])
