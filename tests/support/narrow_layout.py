"""A layout that takes down what a panel draws, and which of it is cut off in a narrow sidebar.

Widths are those of Blender's own font (``blf``); what stands around texts is what Blender puts there at a scale of 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import blf
import bpy

from blender_addon.ui.translation import CONTEXT

_TEXT_PT, _PADDING, _ICON, _UNIT = 11.0, 4.0, 22.0, 20.0
TABS_AND_MARGINS, _BOX, _CHILD = 55.0, 10.0, 6.0
_SPLIT = 0.4
"""Share of a line that a property's name has where names and values are split."""
_NUMBER, _SLIDER, _MENU = 48.0, 60.0, 28.0
"""What a value of three digits needs beside its name, and in a slider; what a menu has around its text."""

spoken: dict[str, str] = {}  # The language's label of each English one; empty for English.


@dataclass(frozen=True)
class _Item:
    """What a layout draws."""

    text: str
    needs: float
    """Pixels."""
    asks: float
    """Pixels that it asks a row for."""


def text_width(text: str) -> float:
    """Return the pixels of a text in the sidebar, in the language that is spoken."""
    blf.size(0, _TEXT_PT)
    return float(blf.dimensions(0, spoken.get(text, text))[0])


class NarrowLayout:
    """Stands for ``bpy.types.UILayout``; ``cut`` lists what does not fit, ``loose`` what Blender takes for its words.

    A row gives icons their size and all texts the same of the rest, however long they are, as Blender's rows do.
    """

    def __init__(self, kind: str = "column", above: NarrowLayout | None = None, less: float = 0.0) -> None:
        self.__dict__.update(kind=kind, less=less, factor=0.0, columns=1, held=[], given={})
        self.__dict__["cut"] = above.cut if above is not None else []
        self.__dict__["drawn"] = above.drawn if above is not None else []
        self.__dict__["loose"] = above.loose if above is not None else []

    def __setattr__(self, name: str, value: Any) -> None:
        self.given[name] = value

    def __getattr__(self, name: str) -> Any:
        return self.given.get(name, False)

    def fit(self, width: float) -> None:
        """Give everything in here its width, and take down what needs more."""
        width -= self.less
        for item, share in zip(self.held, self._shares(width), strict=True):
            if isinstance(item, NarrowLayout):
                item.fit(share)
            elif item.needs > share + 0.5:
                self.cut.append((round(item.needs), round(share), item.text))

    def _shares(self, width: float) -> list[float]:
        if self.kind == "column":
            return [width / self.columns] * len(self.held)
        if self.kind == "split":
            rest = (1 - self.factor) * width / max(len(self.held) - 1, 1)
            return [self.factor * width, *[rest] * (len(self.held) - 1)][: len(self.held)]
        asked = [item.asks for item in self.held]
        icons = sum(ask for ask in asked if ask <= _UNIT)
        texts = sum(ask for ask in asked if ask > _UNIT)
        return [ask if ask <= _UNIT else ask * (width - icons) / texts for ask in asked]

    @property
    def asks(self) -> float:
        """Width that it asks a row for."""
        if units := self.given.get("ui_units_x"):
            return units * _UNIT
        asked = [item.asks for item in self.held]
        return max(asked, default=0.0) if self.kind == "column" else sum(asked)

    def _child(self, kind: str, less: float = 0.0, **values: float) -> NarrowLayout:
        child = NarrowLayout(kind, self, less)
        child.__dict__.update(values)
        child.given.update(self.given)
        child.given.pop("ui_units_x", None)
        self.held.append(child)
        return child

    def row(self, **_: Any) -> NarrowLayout:
        return self._child("row")

    def column(self, **_: Any) -> NarrowLayout:
        return self._child("column")

    def split(self, factor: float, **_: Any) -> NarrowLayout:
        return self._child("split", factor=factor)

    def box(self) -> NarrowLayout:
        return self._child("column", _BOX)

    def grid_flow(self, columns: int = 1, **_: Any) -> NarrowLayout:
        return self._child("column", columns=max(columns, 1))

    def separator(self, **_: Any) -> None:
        pass

    def template_list(self, *_: Any, **__: Any) -> None:
        pass

    def label(self, text: str = "", icon: str = "NONE", **said: Any) -> None:
        self._look_at_context(text, said)
        self._add(text, text_width(text) + (_ICON if icon != "NONE" else _PADDING / 2))

    def progress(self, text: str = "", **said: Any) -> None:
        self._look_at_context(text, said)
        self._add(text, text_width(text) + _PADDING)

    def operator(self, idname: str, text: str | None = None, icon: str = "NONE", **_: Any) -> SimpleNamespace:
        module, name = idname.split(".")
        cls = getattr(bpy.types, f"{module.upper()}_OT_{name}")
        shown = cls.bl_label if text is None else text
        self._add(shown, (text_width(shown) + _PADDING if shown else 0.0) + (_ICON if icon != "NONE" else 0.0))
        return SimpleNamespace()

    def prop(
        self, data: Any, name: str, text: str | None = None, expand: bool = False, icon: str = "NONE",
        slider: bool = False, **said: Any
    ) -> None:  # fmt: skip
        prop = data.bl_rna.properties.get(name)
        if prop is None or prop.translation_context != CONTEXT:
            self._look_at_context(text or "", said)
        shown = prop.name if text is None and prop is not None else text or ""
        kind = prop.type if prop is not None else "FLOAT"
        words = text_width(shown) if shown else 0.0
        extra = _ICON if icon != "NONE" else 0.0
        if kind == "ENUM" and prop.is_enum_flag and text == "":
            self.cut.append((1, 0, f"{prop.name}: its items have no words"))
        if kind == "ENUM" and expand:
            for item in prop.enum_items:
                self._add(item.name, text_width(item.name) + _PADDING)
        elif kind == "ENUM" and not prop.is_enum_flag:
            value = max((text_width(item.name) for item in prop.enum_items), default=0.0) + _MENU
            is_split = self.given.get("use_property_split")
            beside = max(words / _SPLIT, value / (1 - _SPLIT)) if is_split else 2 * max(words, value)
            self._add(shown, beside if shown else value)
        elif self.given.get("use_property_split") and kind != "BOOLEAN":
            self._add(shown, words / _SPLIT if shown else 0.0)
        elif kind == "BOOLEAN":
            self._add(shown, words + (extra or _ICON))
        elif kind in ("INT", "FLOAT"):
            self._add(shown, words + (_SLIDER if slider else _NUMBER) + extra)
        else:
            self._add(shown, 2 * words + extra if shown else 2 * _ICON)

    def prop_enum(self, data: Any, name: str, value: str, text: str | None = None, **said: Any) -> None:
        prop = data.bl_rna.properties[name]
        shown = prop.enum_items[value].name if text is None else text
        if text is not None or prop.translation_context != CONTEXT:
            self._look_at_context(shown, said)
        self._add(shown, text_width(shown) + _PADDING)

    def prop_menu_enum(self, data: Any, name: str, text: str | None = None, **_: Any) -> None:
        shown = data.bl_rna.properties[name].name if text is None else text
        self._add(shown, text_width(shown) + _PADDING + _ICON)

    def prop_search(self, data: Any, name: str, *_: Any, text: str = "", **__: Any) -> None:
        self._add(text, 2 * text_width(text))

    def _look_at_context(self, text: str, said: dict[str, Any]) -> None:
        if text and said.get("translate", True) and said.get("text_ctxt") != CONTEXT:
            self.loose.append(text)

    def _add(self, text: str, width: float) -> None:
        self.drawn.append(text)
        is_icon = not text and width <= _ICON
        self.held.append(_Item(text, min(width, _UNIT) if is_icon else width, _UNIT if is_icon else 10 * _UNIT))


class NarrowContext:
    """The context with a sidebar of some width."""

    def __init__(self, width: int) -> None:
        self.region = SimpleNamespace(width=width)

    def __getattr__(self, name: str) -> Any:
        return getattr(bpy.context, name)


def draw_panel(panel: type, width: int) -> NarrowLayout:
    """Draw a panel into a sidebar of some width."""
    inner = width - TABS_AND_MARGINS - (_CHILD if hasattr(panel, "bl_parent_id") else 0.0)
    layout = NarrowLayout()
    panel.draw(SimpleNamespace(layout=layout), NarrowContext(width))  # type: ignore[attr-defined]
    layout.fit(inner)
    return layout
