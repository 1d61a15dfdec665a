"""Write and read the user's file that assigns a body location to each label of a recording."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from solver_backend.body.hand_markers import hand_labels, hand_place
from solver_backend.body.marker_layouts import load_layouts
from solver_backend.body.marker_names import is_unnamed, name_markers
from solver_backend.body.markers import ON_BONE
from solver_backend.exchange.errors import FileDamaged, MarkersUnknown
from solver_backend.exchange.json_file import read_json_file
from solver_backend.exchange.outputs import write_text
from solver_backend.types import NUM_BODY_JOINTS, SMPL_JOINTS

FORMAT, VERSION = "manifold_mocap_labels", 1
_LARGEST_BYTES = 1_000_000  # Size limit of the file in bytes, chosen by hand.


def write_label_places(path: Path, labels: Sequence[str], *, overwrite: bool = False) -> Path:
    """Write a file with the recognised location of each label: null if unknown, and "" if the label is not used."""
    named, hands = [label for label in labels if not is_unnamed(label)], hand_labels(labels)
    names = name_markers([label for label in named if label not in hands])
    left_out, known = {*names.virtual, *names.doubled}, {**names.known, **hands}
    places = {label: "" if label in left_out else known.get(label) for label in named}
    values = {"format": FORMAT, "version": VERSION, "places": places}
    return write_text(path, json.dumps(values, indent=1, ensure_ascii=False) + "\n", overwrite=overwrite)


def read_label_places(path: Path | str) -> dict[str, str]:
    """Read each label's location. Empty text excludes a marker, and labels with null are omitted.

    A location is a marker name from the layouts, a bone such as ``@left_knee`` (the joint where the bone starts), or a
    hand location such as ``L_FT2``.

    Raises:
        FileMissing, FileDamaged: the file does not exist or has another format.
        MarkersUnknown: a location is unknown.
    """
    path = Path(path)
    values = read_json_file(path, _LARGEST_BYTES)
    if not isinstance(values, dict) or (values.get("format"), values.get("version")) != (FORMAT, VERSION):
        raise FileDamaged(f"The file is not a {FORMAT} of version {VERSION}.", where=str(path))
    places = values.get("places")
    if not isinstance(places, dict) or not all(item is None or isinstance(item, str) for item in places.values()):
        raise FileDamaged("'places' must give a name, an empty string or null for each label.", where=str(path))
    return {label: _place(label, place, path) for label, place in places.items() if place is not None}


def places_given(layout: str) -> dict[str, str]:
    """Read the location of each label from a file (see ``read_label_places``). An empty path gives no locations."""
    return read_label_places(layout) if layout else {}


def _place(label: str, place: str, path: Path) -> str:
    bones = SMPL_JOINTS[: 1 + NUM_BODY_JOINTS]
    if not place or (place.startswith(ON_BONE) and place[len(ON_BONE) :] in bones) or hand_place(place) is not None:
        return place
    found = load_layouts().place_of(place)
    if found is None:
        raise MarkersUnknown(
            f"The position {place!r} of the label {label} is unknown.",
            where=str(path),
            hint="Write a marker name such as LASI or L_FT2, or a joint such as @left_knee. An empty string "
            "leaves the marker out, and null lets the solve find its bone.",
        )
    return found
