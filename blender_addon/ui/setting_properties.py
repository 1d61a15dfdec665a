"""Create Blender properties from the solver's setting declarations and from plain annotations."""

from __future__ import annotations

import inspect
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import GenericAlias
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol, TypeVar, get_args, get_origin

import bpy

from .._exchange.reading_settings import DEFAULTS as READING_DEFAULTS
from .._exchange.reading_settings import ROWS as ALL_READING_ROWS
from .._exchange.reading_settings import options_of
from .._exchange.setting import Choice, Kind, Setting, defaults_of_class, settings_of_class
from .._exchange.solve_settings import METHOD, SolveSettings
from . import ADDON
from .project_files import RELATIVE
from .translation import CONTEXT

DEFAULTS = defaults_of_class(SolveSettings)
ROWS = {name: row for name, row in settings_of_class(SolveSettings).items() if row.in_panel}
"""Solver settings that become properties. The other settings come from sliders, cameras and markers."""
READING_ROWS = {name: row for name, row in ALL_READING_ROWS.items() if row.in_panel}
"""Reading settings that become properties without further declarations."""
CHOSEN_BY_PRESETS = tuple(name for name, row in ROWS.items() if row.group == METHOD)
"""Settings that the user can change only while the preset is Custom."""
_PLAIN = {
    bool: bpy.props.BoolProperty,
    int: bpy.props.IntProperty,
    float: bpy.props.FloatProperty,
    str: bpy.props.StringProperty,
}
_TEXTS = Path(__file__).with_name("choices.txt")
FOLDER = "FOLDER"
"""Value of ``Setting.metavar`` that marks a folder path."""
if TYPE_CHECKING:
    Item = TypeVar("Item", covariant=True)

    class Items(Protocol[Item]):
        """Type annotation of a collection property."""

        def add(self) -> Item: ...
        def remove(self, index: int) -> None: ...
        def clear(self) -> None: ...
        def find(self, name: str) -> int: ...
        def __len__(self) -> int: ...
        def __iter__(self) -> Iterator[Item]: ...
        def __getitem__(self, index: int) -> Item: ...

else:

    class Items:
        """Replacement for ``Items`` at run time.

        ``typing`` caches generics, and a cached Blender class makes the interpreter hang.
        """

        __class_getitem__ = classmethod(GenericAlias)


class PropertyRow(NamedTuple):
    """Declaration of a setting that only the add-on has, used as a property's annotation."""

    setting: Setting
    default: Any
    more: dict[str, Any]  # Further arguments of the property.


def _row(kind: Kind, label: str, description: str, default: Any, more: dict[str, Any], **limits: Any) -> PropertyRow:
    return PropertyRow(Setting(kind, label, description, "", **limits), default, more)


def switch(label: str, description: str, *, on: bool = False, **more: Any) -> PropertyRow:
    """Declare an on/off setting."""
    return _row("switch", label, description, on, more)


def text(label: str, description: str, default: str = "", **more: Any) -> PropertyRow:
    """Declare a text setting."""
    return _row("text", label, description, default, more)


def path(label: str, description: str, *, folder: bool = False, **more: Any) -> PropertyRow:
    """Declare a file or folder setting."""
    return _row("file", label, description, "", more, metavar=FOLDER if folder else "")


def number(
    label: str, description: str, default: float, low: float, high: float, unit: str = "", **more: Any
) -> PropertyRow:
    """Declare a number within limits. It is a whole number if its default is an integer."""
    kind = "whole" if isinstance(default, int) else "number"
    shown: dict[str, Any] = {"unit": unit} if unit else {}
    if unit == "m":
        shown = {"unit": "LENGTH", "precision": 3}
    return _row(kind, label, description, default, shown | more, low=low, high=high)


def choice(label: str, description: str, choices: str | Sequence[Any], default: str = "", **more: Any) -> PropertyRow:
    """Declare a setting with choices, given directly or by name in ``choices.txt``. The first is the default."""
    items = _choices(choices)
    return _row("choice", label, description, default or items[0].value, more, choices=items)


def flags(label: str, description: str, choices: str | Sequence[Any], *chosen: str, **more: Any) -> PropertyRow:
    """Declare a setting that allows several choices at once. ``chosen`` are enabled by default."""
    return _row("texts", label, description, chosen, more, choices=_choices(choices))


def _choices(choices: str | Sequence[Any]) -> tuple[Choice, ...]:
    items = items_of(choices) if isinstance(choices, str) else choices
    return tuple(item if isinstance(item, Choice) else Choice(*item) for item in items)


def items_of(name: str) -> tuple[tuple[str, str, str], ...]:
    """Return the identifier, label and tooltip of each choice of a property in ``choices.txt``."""
    text = _TEXTS.read_text(encoding="utf-8")
    rows = text.partition(f"[{name}]\n")[2].partition("\n\n")[0].splitlines()
    parts = [row.removesuffix(" =").split(" = ") for row in rows]
    return tuple((identifier, label, "".join(tooltip)) for identifier, label, *tooltip in parts)


def prepare(cls: Any) -> Any:
    """Prepare a class for registration: create its properties and set the add-on's translation context.

    Annotations of the class and its mixins become properties. A ``PropertyRow`` becomes a labelled property.
    An annotation such as ``frames: int = 1`` becomes a property without a label, which operators hide.
    """
    if issubclass(cls, bpy.types.Operator | bpy.types.Panel | bpy.types.Menu):
        cls.bl_translation_context = CONTEXT
    if not issubclass(cls, bpy.types.Operator | bpy.types.PropertyGroup | bpy.types.AddonPreferences):
        return cls
    for base in cls.__mro__:
        if base is cls or (base.__module__.startswith(ADDON) and not issubclass(base, bpy.types.bpy_struct)):
            _declare(base, hidden=not issubclass(cls, bpy.types.PropertyGroup))
    return cls


def _declare(cls: Any, *, hidden: bool) -> None:
    hints = inspect.get_annotations(cls, eval_str=True)
    for name, hint in hints.items():
        if not name.startswith("_") and get_origin(hint) is not ClassVar:
            hints[name] = _property(cls, name, hint, {"options": {"HIDDEN", "SKIP_SAVE"}} if hidden else {})
            hints[name].keywords.setdefault("translation_context", CONTEXT)
    cls.__annotations__ = hints


def _property(cls: Any, name: str, hint: Any, hidden: dict[str, Any]) -> Any:
    if hasattr(hint, "keywords"):
        return hint
    if isinstance(hint, PropertyRow):
        return _make_property(hint.setting, hint.default, **hint.more)
    if hint not in _PLAIN:
        many = get_origin(hint) is Items
        declare = bpy.props.CollectionProperty if many else bpy.props.PointerProperty
        return declare(type=get_args(hint)[0] if many else hint, **hidden)
    default = cls.__dict__.get(name, hint())
    if name in cls.__dict__:
        delattr(cls, name)
    return _PLAIN[hint](default=default, **hidden)


def properties_of(rows: Mapping[str, Setting], defaults: Mapping[str, Any], **more: Any) -> Any:
    """Return a mixin with one Blender property per setting. ``more`` applies to each property."""
    made = {name: _make_property(row, defaults[name], **more) for name, row in rows.items()}
    return type("SettingProperties", (), {"__annotations__": made})


def names_of(group: str) -> tuple[str, ...]:
    """Return the names of a group's solver settings that have a property."""
    return tuple(name for name, row in ROWS.items() if row.group == group)


def listed(name: str, items: Any) -> Any:
    """Return the Blender property of a reading setting, with these choices in its menu."""
    row = ALL_READING_ROWS[name]
    return bpy.props.EnumProperty(name=row.label, description=row.description, items=items, translation_context=CONTEXT)


def _make_property(row: Setting, default: Any, **more: Any) -> Any:
    """Return the Blender property for a setting. Empty text and 0 mean that the user has not set a value."""
    words: dict[str, Any] = {"name": row.label, "description": row.description, "translation_context": CONTEXT} | more
    if row.kind == "switch":
        return bpy.props.BoolProperty(**words, default=default)
    if row.kind in ("choice", "texts") and row.choices:
        items = [(choice.value, choice.label, choice.description) for choice in row.choices]
        if row.kind == "texts":
            return bpy.props.EnumProperty(**words, items=items, options={"ENUM_FLAG"}, default=set(default or ()))
        # Blender saves the number of a choice, by default its position, which changes with the list. Buttons store
        # the number in single precision, which keeps 24 bits. With a larger number, a click would set another one.
        numbered = [(*item, zlib.crc32(item[0].encode()) >> 8) for item in items]
        return bpy.props.EnumProperty(**words, items=numbered, default=default)
    if row.kind == "file":
        subtype = "DIR_PATH" if row.metavar == FOLDER else "FILE_PATH"
        return bpy.props.StringProperty(**{"options": RELATIVE, **words}, subtype=subtype, default=default or "")
    if row.kind in ("texts", "range", "name_or_file", "text"):
        form = {"texts": f", separated by commas: {row.metavar}", "range": f": {row.metavar}"}.get(row.kind, "")
        words["description"] += form
        if row.choices:
            names = [(choice.value, choice.description) for choice in row.choices]
            words |= {"search": lambda _self, _context, _text: names, "search_options": {"SUGGESTION"}}
        return bpy.props.StringProperty(**words, default=(default or "") if row.kind == "text" else "")
    if default is None:
        words["description"] += " (0 is automatic)"
        return bpy.props.FloatProperty(**words, default=0.0, min=0.0, max=row.high, soft_max=row.soft_high or row.high)
    declare = bpy.props.IntProperty if row.kind == "whole" else bpy.props.FloatProperty
    limits = {"min": row.low, "max": row.high, "soft_max": row.soft_high}
    limits = {name: limit for name, limit in limits.items() if limit is not None}
    return declare(**{**limits, **words, "default": default})


def reset_unknown(group: Any) -> None:
    """Reset menu choices in an opened file that this version does not have."""
    for name, prop in group.bl_rna.properties.items()[1:]:  # The first one is the type.
        if prop.type == "ENUM" and prop.enum_items_static and not prop.is_enum_flag and not getattr(group, name):
            group.property_unset(name)
        elif prop.type == "POINTER" and isinstance(inner := getattr(group, name), bpy.types.PropertyGroup):
            reset_unknown(inner)
        elif prop.type == "COLLECTION":
            for item in getattr(group, name):
                reset_unknown(item)


def panel_values(properties: Any, names: tuple[str, ...] = tuple(ROWS)) -> dict[str, Any]:
    """Return the solver settings as a job file stores them, without empty texts."""
    values: Mapping[str, Any] = {name: getattr(properties, name) for name in names}
    # Blender's numbers are in single precision: 0.1 is 0.10000000149.
    plain = {name: round(value, 4) if isinstance(value, float) else value for name, value in values.items()}
    plain |= {name: tuple(str(plain[name]).replace(",", " ").split()) for name in names if ROWS[name].kind == "texts"}
    return {name: value for name, value in plain.items() if value not in ("", ())}


def reading_options(properties: Any, listed: Mapping[str, str]) -> list[str]:
    """Return the solver's options for the reading settings, and for the menu choices in ``listed``."""
    plain = {name: _plain(row, getattr(properties, name)) for name, row in READING_ROWS.items()}
    return options_of(plain | dict(listed))


def _plain(row: Setting, value: Any) -> Any:
    if row.kind == "texts":
        return [text.strip() for text in value.split(",") if text.strip()]
    if row.kind == "range":
        return value.split()
    if row.kind in ("number", "text"):
        return (float(f"{value:.6g}") if isinstance(value, float) else value) or None
    return value


SolveProperties = properties_of(ROWS, DEFAULTS)
ReadingProperties = properties_of(READING_ROWS, READING_DEFAULTS)
