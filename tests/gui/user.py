"""A user who finds buttons of the sidebar by hovering over them, scrolls, opens panels and drags the edge.

Which button lies under the mouse is asked with Blender's own "Copy Python Command" and "Copy Data Path".
"""

from __future__ import annotations

from collections.abc import Generator
from itertools import product
from pathlib import Path

import bpy

from tests.gui.hands import Hands, Steps

_STEP_PX = 14
_NEAR_PX = 20
_SCROLL_WAITS = 12
"""Tenths of a second after which the wheel has moved nothing."""
_ROW_PX = 20  # Height of a button; the stages stand in two rows where the sidebar is narrow.
_MARGIN_PX = 12  # From the sidebar's edge to where no list or field takes the wheel for itself.
_BELOW_EDGE_PX = 30  # From the sidebar's top to where a panel takes the wheel, and not the viewport.
_LAG = 8  # Moves of the mouse and turns of the wheel by which a slow screen may lag behind.
STAGES = {
    "CAPTURE": (
        "cameras[", "view_camera", "leave_out", "use_range", "check_cameras", "refine_cameras", "restore_cameras",
        "import_capture", "demo_capture", "capture_from_videos", "video_step", "label_point", "pick_point", "people",
        ".reading.", "show_names", "show_residuals", "leave_camera", "import_motion", "show_capture", "person_shown",
    ),
    "SOLVE CAPTURE": ("mocap.solve()",),
    "SOLVE": ("solve.preset", "solve_all", "calibrate_subject", "solve.estimate_sync", "solve.subject"),
    "EDIT": (
        "show_take", "delete_take", "thin_take", "edit_on_layer", "push_down", "mark_take", "pin_pose", "resolve_range",
        "show_confidence", "open_report", "mocap.look", "feet_to_floor", "lock_feet", "mark_gaps", "switch_limbs",
        "floor_offset", "ghost_take",
    ),
    "DELIVER": (
        "export_take", "export_markers", "format='", 'node="', "map_rig", "mocap.retarget", "set_map_pose",
        "save_preset", "motion_from_rig", "retarget.actor", "retarget.target",
    ),
}  # fmt: skip
"""Where a button stands, by a part of what it does; several stages where each has it."""
_TO_THE_TOP, _PAGE, _PAGES = -90, 5, 22  # Turns of the wheel to the top and for a page, and pages at most.


class User(Hands):
    """What a user can do; every method that takes time is a generator."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self._last_y = 10_000

    def under_mouse(self) -> str:
        """What the button under the mouse does: its Python command or its data path."""
        manager = bpy.context.window_manager
        for ask in (bpy.ops.ui.copy_python_command_button, bpy.ops.ui.copy_data_path_button):
            with self.override:
                if ask.poll():
                    manager.clipboard = ""
                    ask()
                    if manager.clipboard:
                        return manager.clipboard
        return ""

    def open_stage(self, stage: str) -> Steps:
        """Open one of the sidebar's stages; ``pages`` and ``find`` see the panels of the open one alone."""
        mocap = bpy.context.scene.mocap
        if mocap.stage == stage:
            return
        names = [item.identifier for item in mocap.bl_rna.properties["stage"].enum_items]
        region, index, clicks = self.region("UI"), names.index(stage), self.clicks
        yield from self._scroll(_TO_THE_TOP)
        self._last_y = region.y + region.height  # a button below opens a stage, too
        _, y = yield from self._found("mocap.stage")
        for columns, below in ((len(names), 0), *((2, px) for px in (0, _ROW_PX, -_ROW_PX))):
            x = int(region.x + (index % columns + 0.5) / columns * (region.width - 24))
            yield from self.click(x, y - below)
            yield 0.3
            if bpy.context.scene.mocap.stage == stage:
                break
        self.clicks = clicks + 1  # the others look for where the button is
        assert bpy.context.scene.mocap.stage == stage, f"the click opened {bpy.context.scene.mocap.stage}"
        self.note(f"opened the stage {stage}")

    def find(self, words: str, across: float = 0.5) -> Generator[float | None, None, tuple[int, int]]:
        """Open the stage that the words belong to and find a button that holds them."""
        stage = next((stage for stage, known in STAGES.items() if any(word in words for word in known)), None)
        in_stages = self.region("UI").active_panel_category == "MoCap"
        if stage is not None and in_stages and bpy.context.scene.mocap.stage not in stage.split():
            yield from self.open_stage(stage.split()[0])
        return (yield from self._found(words, across))

    def _found(self, words: str, across: float = 0.5) -> Generator[float | None, None, tuple[int, int]]:
        """Hover over the sidebar, near the last find first and scrolling if need be, until a button holds the words."""
        region = self.region("UI")
        x = int(region.x + across * (region.width - 24))
        seen: set[str] = set()
        for slow in (False, True):
            for scroll in (0, _TO_THE_TOP, *[_PAGE] * _PAGES):
                moved = yield from self._scroll(scroll)
                if scroll > 0 and not moved:
                    break
                there = yield from self._hover(words, x, nearest_first=scroll == 0, slow=slow, seen=seen)
                if there is not None:
                    self._last_y = there
                    return x, there
        raise AssertionError(f"No button '{words}' in the sidebar; there are {sorted(seen)}")

    def _hover(
        self, words: str, x: int, *, nearest_first: bool, slow: bool, seen: set[str]
    ) -> Generator[float | None, None, int | None]:
        """Move the mouse down the page; return the height of the button with the words, None if there is none."""
        region = self.region("UI")
        heights = range(region.y + region.height - 6, region.y + 6, -_STEP_PX)
        passed: list[int] = []
        for y in sorted(heights, key=lambda y: abs(y - self._last_y)) if nearest_first else heights:
            yield from self.move(x, y)
            if slow:
                yield 0.1
            passed.append(y)
            found = self.under_mouse()
            seen.add(found)
            if words not in found:
                continue
            for there in passed[: -_LAG - 1 : -1]:
                yield from self.move(x, there)
                if (yield from self.stays(words, x, there)):
                    return there
        return None

    def press(self, words: str, across: float = 0.5) -> Steps:
        """Find a button and click it."""
        x, y = yield from self.find(words, across)
        yield from self.click(x, y)
        self.note(f"clicked {words}")

    def type_into(self, words: str, text: str, across: float = 0.5) -> Steps:
        """Find a field, click into it, and type."""
        x, y = yield from self.find(words, across)
        yield from self.click(x, y)
        yield 0.3
        yield from self.type_text(text)
        self.note(f"typed {text} into {words}")

    def pages(self, name: str) -> Steps:
        """Have screenshots taken of the whole sidebar, stage by stage and page by page."""
        opened = bpy.context.scene.mocap.stage
        for stage in ("CAPTURE", "SOLVE", "EDIT", "DELIVER"):
            yield from self.open_stage(stage)
            yield from self._scroll(_TO_THE_TOP)
            for page in range(_PAGES):
                yield from self.shot(f"{name}_{stage.lower()}_{page + 1}")
                if not (yield from self._scroll(_PAGE)):
                    break
        yield from self._scroll(_TO_THE_TOP)
        yield from self.open_stage(opened)

    def open_from_the_start(self, package: str, *names: str) -> Steps:
        """Have panels open that were not drawn yet: those that are named, all where none is."""
        ours = [cls for cls in bpy.types.Panel.__subclasses__() if cls.__module__.startswith(package)]
        panels = sorted(ours, key=lambda cls: hasattr(cls, "bl_parent_id"))
        for cls in reversed(panels):
            bpy.utils.unregister_class(cls)
        for cls in panels:
            if "DEFAULT_CLOSED" in getattr(cls, "bl_options", ()) and (not names or cls.__name__ in names):
                cls.bl_options = cls.bl_options - {"DEFAULT_CLOSED"}
            bpy.utils.register_class(cls)
        yield 0.3
        self.note(f"open from the start: {', '.join(names) or 'all panels'}")

    def open_acquisition(self, package: str) -> Steps:
        """Ask for the tab of acquisition in the preferences, and open it."""
        bpy.context.preferences.addons[package].preferences.acquisition = True
        yield 0.3
        yield from self.open_tab("Acquire")

    def open_panel(self, name: str, *, at_the_end: bool = False) -> Steps:
        """Open a closed panel by a click on its header; which header it is shows when the panel is drawn.

        Headers are tried from what was clicked last downwards or, if so told, from the sidebar's end upwards.
        """
        panel, drawn = getattr(bpy.types, name), []
        if hasattr(panel, "stage"):
            yield from self.open_stage(panel.stage)
        draw = panel.draw

        def noticed(shown: bpy.types.Panel, context: bpy.types.Context) -> None:
            drawn.append(name)
            draw(shown, context)

        panel.draw = noticed
        try:
            self.viewport.tag_redraw()
            yield 0.3
            if not drawn:
                yield from self._click_headers(drawn, at_the_end)
        finally:
            panel.draw = draw
        self.note(f"opened {name}")

    def _click_headers(self, drawn: list[str], at_the_end: bool) -> Steps:
        """Click on what is no button until the panel is drawn; other panels are opened and closed again."""
        region = self.region("UI")
        x = int(region.x + 0.3 * (region.width - 24))
        heights = range(region.y + region.height - 6, region.y + 6, -_STEP_PX)
        near = sorted(heights, key=lambda y: (y >= self._last_y, -y))
        ways = [(60, heights[::-1])] if at_the_end else [(0, near)]
        for scroll, tried in (*ways, (-60, heights), *[(12, heights)] * 12):
            yield from self._scroll(scroll)
            yield 0.1
            for y in tried:
                yield from self.move(x, y)
                if self.under_mouse() or not (yield from self.stays("", x, y)):
                    continue
                yield from self.click(x, y)
                yield 0.2
                if drawn:
                    self._last_y = y
                    return
                yield from self.click(x, y)
        raise AssertionError("No header opens the panel")

    def narrow(self, width: int) -> Steps:
        """Drag the sidebar's edge until it is so wide; what can be grabbed lies a little off it."""
        for beside, below in product((8, 0, 4, 12), (60, 160, 260)):
            region = self.region("UI")
            x, y = region.x + beside, region.y + region.height - below  # a panel: the empty lets clicks through
            to = x + region.width - width
            yield from self.move(x - 30, y)
            yield from self.move(x, y)
            yield 0.4
            self.window.event_simulate(type="LEFTMOUSE", value="PRESS", x=x, y=y)
            yield 0.2
            for step in range(1, 21):
                yield from self.move(x + (to - x) * step // 20, y)
            yield 0.4
            self.window.event_simulate(type="LEFTMOUSE", value="RELEASE", x=to, y=y)
            yield 0.8
            if abs(self.region("UI").width - width) <= _NEAR_PX:
                break
        self.note(f"the sidebar is {self.region('UI').width} px wide")
        assert abs(self.region("UI").width - width) <= _NEAR_PX

    def stays(self, words: str, x: int, y: int) -> Generator[float | None, None, bool]:
        """Whether the button is still there once Blender has caught up with the mouse."""
        yield 0.15
        yield from self.move(x + 1, y)
        yield 0.1
        found = self.under_mouse()
        return words in found if words else not found

    def _offset(self) -> float:
        """Return how far the sidebar is scrolled."""
        return float(self.region("UI").view2d.region_to_view(0.0, 0.0)[1])

    def _scroll(self, lines: int) -> Generator[float | None, None, bool]:
        """Turn the wheel, and return whether that moved the panels; a slow screen takes a while to follow."""
        region, before = self.region("UI"), self._offset()
        x, y = region.x + _MARGIN_PX, region.y + region.height - _BELOW_EDGE_PX
        still, last = 0, before
        for _ in range(abs(lines)):
            self.window.event_simulate(type="WHEELDOWNMOUSE" if lines > 0 else "WHEELUPMOUSE", value="PRESS", x=x, y=y)
            yield None
            still, last = still + 1 if self._offset() == last else 0, self._offset()
            if still > _LAG:
                break  # at the end
        for _ in range(_SCROLL_WAITS if lines else 0):
            yield 0.1
            if self._offset() != before:
                yield 0.2
                return True
        return False
