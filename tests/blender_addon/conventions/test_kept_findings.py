"""Diagnostics kept as text are read back, once for all redraws of a panel."""

from __future__ import annotations

from blender_addon._exchange.diagnostics import diagnostic
from blender_addon.conventions.kept_findings import findings_in, findings_text


def test_a_text_is_read_once_and_one_of_another_kind_has_none() -> None:
    found = diagnostic("image_mirrored", cameras=("front",))
    text = findings_text([found])
    assert findings_in(text) == (found,)
    assert findings_in(text) is findings_in("".join(text))
    assert findings_in("") == findings_in("{") == findings_in("3") == ()
