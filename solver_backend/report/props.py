"""The page's section about props: how surely each is known over time."""

from __future__ import annotations

import numpy as np

from solver_backend.report.markup import section, text
from solver_backend.report.plots import WIDTH, PlotCurve, time_plot
from solver_backend.types import Motion


def props_section(motion: Motion) -> str:
    """Each prop's standard deviations over time, and how many of its markers are seen."""
    lead = (
        "Things with markers that the person does not wear, solved as rigid bodies. The curves are the standard "
        "deviation of the origin, and that of the rotation about the axis that is known least."
    )
    parts = list[str]()
    for prop in motion.props:
        seen = 100 * (np.asarray(prop.seen) >= 3).mean()
        who = f"{len(prop.labels)} markers ({', '.join(prop.labels)})"
        facts = f"{who}; three or more are seen in {seen:.0f} % of the frames"
        place = time_plot(
            [PlotCurve(1000 * prop.sigma[:, 0], "origin", "a")], motion.fps, "mm", from_zero=True, size=(WIDTH, 120)
        )
        turn = time_plot(
            [PlotCurve(np.degrees(prop.sigma[:, 1]), "rotation", "b")], motion.fps, "°", from_zero=True,
            size=(WIDTH, 120),
        )  # fmt: skip
        parts.append(f"<h3>{text(prop.name)}</h3><p>{text(facts)}</p>{place}{turn}")
    return section("Props", "".join(parts), lead, "props") if parts else ""
