"""What stands in documents: numbers, words and trees, now and then another than the sound file has."""

from __future__ import annotations

from typing import Any

from hypothesis import strategies as st

ODDLY = 24
"""One of so many values is another than the sound file's."""
SCALARS = st.one_of(
    st.none(), st.booleans(), st.integers(-(2**70), 2**70), st.floats(), st.text(max_size=8),
    st.sampled_from([0, -1, 1, 2**31, 2**63, 1e308, 1e-308, 1e30, -1e9, "", "nan", "1", "\u0661", "\0", "a/../b", "é"]),
)  # fmt: skip
TREES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=6,
)
NUMBERS = st.one_of(
    st.floats().map(repr),
    st.integers(-(10**25), 10**25).map(str),
    st.sampled_from(
        ["", "-", "+1", "1,5", "1.5e3", "1E400", "-.5", "5.", "0x10", "1_000", "NaN", "inf", "#N/A", '"1"']
    ),
)
"""As tables and texts write them, in several countries' ways."""


@st.composite
def oddly(draw: st.DrawFn, usual: Any, other: st.SearchStrategy[Any]) -> Any:
    """Draw the usual value, seldom another."""
    return draw(other) if draw(st.integers(0, ODDLY - 1)) == 0 else usual


@st.composite
def tree_like(draw: st.DrawFn, sound: Any) -> Any:
    """Draw a tree of the same grammar: keys left out or added, lists shorter or longer, values of other kinds."""
    if draw(st.integers(0, 4 * ODDLY - 1)) == 0:
        return draw(TREES)
    if isinstance(sound, dict):
        found = {draw(oddly(key, st.text(max_size=6))): draw(tree_like(value)) for key, value in sound.items()}
        for key in list(found):
            if draw(st.integers(0, 2 * ODDLY - 1)) == 0:
                del found[key]
        return found
    if isinstance(sound, list):
        if len(sound) > 40:  # numbers of a long list are alike: one of them changes
            at = draw(st.integers(0, len(sound) - 1))
            return [*sound[:at], draw(tree_like(sound[at])), *sound[at + 1 :]]
        found = [draw(tree_like(value)) for value in sound]
        length = draw(oddly(len(found), st.integers(0, 2 * len(found) + 2)))
        return (found * 2 + [draw(SCALARS)] * 2)[:length] if length != len(found) else found
    if isinstance(sound, float) and draw(st.integers(0, ODDLY - 1)) == 0:
        return draw(st.floats())
    return draw(oddly(sound, SCALARS))
