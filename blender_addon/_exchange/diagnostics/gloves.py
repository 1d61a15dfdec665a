"""Diagnostics of gloves whose hands are added to a motion."""

from __future__ import annotations

from .entry import DiagnosticEntry, note, warning

GLOVES: dict[str, DiagnosticEntry] = {
    "gloves_time_found": note(
        "The gloves begin {offset:+.2f} s after the motion, by the turns of the wrists, which correlate by "
        "{agreement:.0f} %",
        "The two recordings were started apart, or together.",
    ),
    "gloves_time_unsure": warning(
        "The turns of the wrists agree at no one time: the best, {offset:+.2f} s, correlates by {agreement:.0f} %. "
        "The gloves begin with the motion",
        "Gloves and body are of other takes, or the wrists turn too little or in a steady beat.",
        "Give --offset, the second of the motion at which the gloves begin; clap or shake the hands at the start of a "
        "take.",
    ),
    "gloves_time_unknown": warning(
        "The gloves' wrists do not turn, so that nothing shows when they began: they begin with the motion",
        "The file holds hands without their orientation, or less than two seconds are shared.",
        "Give --offset, the second of the motion at which the gloves begin.",
    ),
    "gloves_sides_exchanged": warning(
        "The left glove turns as the right wrist, and the other way round: they correlate by {agreement:.0f} %. The "
        "gloves begin with the motion",
        "Left and right are exchanged in one of the recordings.",
        "Check which glove is which, or whether the body's sides are exchanged.",
    ),
    "gloves_cover_part": warning(
        "The gloves cover {share:.0f} % of the motion: fingers rest elsewhere",
        "They were started later or stopped earlier.",
        "Check --offset, or cut the motion.",
    ),
    "gloves_angles_unknown": note(
        "Not in the file, and the likeliest beside what is: {angles}",
        "Tables of angles count spreads and the thumb's root from zeros of their own; gloves may lack sensors.",
    ),
    "gloves_beyond_ranges": warning(
        "The {side} hand bends beyond what people can: {angles}",
        "The gloves were not calibrated, or slipped.",
        "Calibrate the gloves and export again, or edit the fingers in Blender.",
    ),
}
"""By code."""
