"""Pictures from files, as icons that panels show large."""

from __future__ import annotations

from pathlib import Path

import bpy.utils.previews  # pyright: ignore[reportMissingImports]


class Previews:
    """The pictures that have been shown, each loaded once and again when its file changes."""

    def __init__(self) -> None:
        self._shown: bpy.utils.previews.ImagePreviewCollection | None = None

    def start(self) -> None:
        """Begin; for registering."""
        self._shown = bpy.utils.previews.new()

    def stop(self) -> None:
        """Let go of all pictures; for unregistering."""
        if self._shown is not None:
            bpy.utils.previews.remove(self._shown)
        self._shown = None

    @property
    def loaded(self) -> tuple[str, ...]:
        """What is loaded now: paths and the times of their files."""
        return () if self._shown is None else tuple(self._shown)

    def icon(self, path: Path) -> int:
        """Return the icon of a picture, 0 where it cannot be shown."""
        if self._shown is None:
            return 0
        try:
            name = f"{path}|{path.stat().st_mtime_ns}"
        except OSError:
            return 0
        if name not in self._shown:
            for former in [key for key in self._shown if key.split("|")[0] == str(path)]:
                del self._shown[former]
            self._shown.load(name, str(path), "IMAGE")
        return self._shown[name].icon_id


previews = Previews()
