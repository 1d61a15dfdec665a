"""Diagnostics of sensors that are calibrated by a waved wand and a Γ on the floor."""

from __future__ import annotations

from .entry import DiagnosticEntry, note, warning

WAND: dict[str, DiagnosticEntry] = {
    "wand_seen": note(
        "By {wand} at {moments} moments; {camera} and {other_camera} saw least together, {together}",
        "The sensors were calibrated by the moments at which several of them saw the wand.",
    ),
    "world_of_first_sensor": note(
        "The world is {camera}'s own axes, Z along its sight, until a Γ shows the up direction",
        "A waved wand shows where sensors stand to one another, not where the floor is.",
    ),
    "world_by_gamma": note(
        "Up by a Γ in {clouds} clouds, ± {sigma_deg:.2f}°; the origin lies on the floor below its corner, X along its "
        "short edge",
        "Three markers on the floor were found whose distances are the Γ's.",
    ),
    "gamma_mirrored": warning(
        "The Γ lies mirrored, its short edge to the left: the up direction comes from the sensors' positions",
        "Seen from above, the short edge goes to the right of the long one.",
        "Turn the Γ over if the sensors do not all stand above the floor.",
    ),
    "wand_times_back": warning(
        "{camera}: {lost} rows go backwards in time, the first after {after:.3f} s; left out",
        "The sensor sent frames late, or two recordings are in one file.",
        "Put each recording into a file of its own.",
    ),
    "wand_crowded": warning(
        "{camera}: in {lost} of {of} frames more than the wand was lit; they were left out",
        "Another marker, a lamp or a reflection was in sight.",
        "Remove it, or record the empty scene for a mask.",
    ),
    "sensor_off_wand": warning(
        "{camera} is off by {size:.1f} px",
        "Its lens was calibrated in another mode, it was moved, or its exposures are long for how fast the wand was "
        "waved.",
        "Calibrate its lens in the mode that it records in, and wave more slowly.",
    ),
    "sensor_clock_differs": warning(
        "The clock of {camera} is {size_ms:+.1f} ms off that of {other_camera}",
        "The sensors have no common trigger, or their trigger is not connected.",
        "The calibration takes the difference into account; connect the sync wire to be exact.",
    ),
}
"""By code."""
