"""The provenance of our own files: JSON text whose known entries are of the types that readers of it rely on."""

from __future__ import annotations

import json
from typing import Any

from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.schema import Fields

_TYPES: dict[str, tuple[type, ...]] = {
    "edits": (list,), "resolved": (list,), "exchanged": (list,), "sigma_px": (list,), "settings": (dict,),
    "person": (str,), "solver": (str,), "solve_s": (int, float),
}  # fmt: skip
"""Of the entries that the product reads back; whatever else is there is only shown."""
_ITEMS: dict[str, tuple[type, ...]] = {
    "edits": (dict,),
    "resolved": (dict,),
    "exchanged": (list,),
    "sigma_px": (int, float),
}
"""Of the items of those that are lists."""


def read_provenance(fields: Fields) -> dict[str, Any]:
    """Return the provenance of a file, empty where it has none.

    Raises:
        FileDamaged: it is no JSON object, or an entry is of another type.
    """
    where = str(fields.path)
    try:
        value = json.loads(fields.text("provenance", "{}"))
    except (ValueError, RecursionError) as error:
        raise FileDamaged(f"The provenance is not JSON ({error}).", where=where) from error
    if not isinstance(value, dict):
        raise FileDamaged("The provenance is not a JSON object.", where=where)
    for key, types in _TYPES.items():
        entry = value.get(key)
        items = entry if isinstance(entry, list) and key in _ITEMS else []
        if not (entry is None or isinstance(entry, types)) or not all(isinstance(item, _ITEMS[key]) for item in items):
            raise FileDamaged(
                f"The provenance's '{key}' has an unexpected type.", where=where,
                hint="Solve the take again, or copy the file again.",
            )  # fmt: skip
    return value
