"""A layout that takes down what a panel draws, and which of it is cut off in a narrow sidebar.

Widths are those of Blender's own font (``blf``); what stands around texts is what Blender puts there at a scale of 1.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import blf
import bpy

_TEXT_PT, _PADDING, _ICON, _UNIT = 11.0, 4.0, 22.0, 20.0
_TABS_AND_MARGINS, _BOX, _CHILD = 55.0, 10.0, 6.0
_SPLIT = 0.4
"""Share of a line that a property's name has where names and values are split."""
_NUMBER = 40.0


def text_width(text: str) -> float:
    """Return the pixels of a text in the sidebar."""
    blf.size(0, _TEXT_PT)
    return float(blf.dimensions(0, text)[0])


class NarrowLayout:
    """Stands for ``bpy.types.UILayout``; ``cut`` lists what does not fit."""

    def __init__(self, width: float, kind: str = "column", above: NarrowLayout | None = None) -> None:
        self.__dict__.update(width=width, kind=kind, above=above, used=0.0, columns=1, held=[], given={})
        self.__dict__["cut"] = above.cut if above is not None else []
        self.__dict__["drawn"] = above.drawn if above is not None else []

    def __setattr__(self, name: str, value: Any) -> None:
        self.given[name] = value

    def __getattr__(self, name: str) -> Any:
        return self.given.get(name, False)

    def close(self) -> float:
        """Return the natural width of everything in here, children first, and take down rows that are too full."""
        inside = [child.close() for child in self.held if isinstance(child, NarrowLayout)]
        plain = [width for width in self.held if not isinstance(width, NarrowLayout)]
        total = (
            sum(inside) + sum(w for w, _ in plain)
            if self.kind == "row"
            else max([0.0, *inside, *(w for w, _ in plain)])
        )
        if self.kind == "row" and total > self.width + 0.5:
            self.cut.append((round(total), round(self.width), " | ".join(text for _, text in plain)))
        fixed = self.given.get("ui_units_x")
        return fixed * _UNIT if fixed else total

    def _child(self, kind: str, less: float = 0.0) -> NarrowLayout:
        child = NarrowLayout(self.width - less, kind, self)
        child.given.update(self.given)
        child.given.pop("ui_units_x", None)
        self.held.append(child)
        return child

    def row(self, **_: Any) -> NarrowLayout:
        return self._child("row")

    def column(self, **_: Any) -> NarrowLayout:
        return self._child("column")

    def box(self) -> NarrowLayout:
        return self._child("column", _BOX)

    def grid_flow(self, columns: int = 1, **_: Any) -> NarrowLayout:
        return self._child("column", self.width * (1 - 1 / max(columns, 1)))

    def separator(self, **_: Any) -> None:
        pass

    def template_list(self, *_: Any, **__: Any) -> None:
        pass

    def label(self, text: str = "", icon: str = "NONE", **_: Any) -> None:
        self._add(text, text_width(text) + (_ICON if icon != "NONE" else _PADDING / 2))

    def progress(self, text: str = "", **_: Any) -> None:
        self._add(text, text_width(text) + _PADDING)

    def operator(self, idname: str, text: str | None = None, icon: str = "NONE", **_: Any) -> SimpleNamespace:
        module, name = idname.split(".")
        cls = getattr(bpy.types, f"{module.upper()}_OT_{name}")
        shown = cls.bl_label if text is None else text
        self._add(shown, (text_width(shown) + _PADDING if shown else 0.0) + (_ICON if icon != "NONE" else 0.0))
        return SimpleNamespace()

    def prop(
        self, data: Any, name: str, text: str | None = None, expand: bool = False, icon: str = "NONE", **_: Any
    ) -> None:
        prop = data.bl_rna.properties.get(name)
        shown = prop.name if text is None and prop is not None else text or ""
        kind = prop.type if prop is not None else "FLOAT"
        words = text_width(shown) if shown else 0.0
        extra = _ICON if icon != "NONE" else 0.0
        if kind == "ENUM" and expand:
            for item in prop.enum_items:
                self._add(item.name, text_width(item.name) + _PADDING)
        elif self.given.get("use_property_split") and kind != "BOOLEAN":
            self._add(shown, words / _SPLIT if shown else 0.0)
        elif kind == "BOOLEAN":
            self._add(shown, words + (extra or _ICON))
        elif kind in ("INT", "FLOAT"):
            self._add(shown, words + _NUMBER + extra)
        else:
            self._add(shown, 2 * words + extra if shown else 2 * _ICON)

    def prop_menu_enum(self, data: Any, name: str, text: str | None = None, **_: Any) -> None:
        shown = data.bl_rna.properties[name].name if text is None else text
        self._add(shown, text_width(shown) + _PADDING + _ICON)

    def prop_search(self, data: Any, name: str, *_: Any, text: str = "", **__: Any) -> None:
        self._add(text, 2 * text_width(text))

    def _add(self, text: str, width: float) -> None:
        self.drawn.append(text)
        self.held.append((width, text))
        if self.kind != "row" and width > self.width + 0.5:
            self.cut.append((round(width), round(self.width), text))


class NarrowContext:
    """The context with a sidebar of some width."""

    def __init__(self, width: int) -> None:
        self.region = SimpleNamespace(width=width)

    def __getattr__(self, name: str) -> Any:
        return getattr(bpy.context, name)


def draw_panel(panel: type, width: int) -> NarrowLayout:
    """Draw a panel into a sidebar of some width."""
    inner = width - _TABS_AND_MARGINS - (_CHILD if hasattr(panel, "bl_parent_id") else 0.0)
    layout = NarrowLayout(inner)
    panel.draw(SimpleNamespace(layout=layout), NarrowContext(width))  # type: ignore[attr-defined]
    layout.close()
    return layout
