"""Write the page about a labelled take: share and confidence of labels, and frame ranges to check."""

from __future__ import annotations

import numpy as np

from solver_backend.labelling.label_take import LabelledTake
from solver_backend.labelling.outputs import GHOST, MARKERS
from solver_backend.report.markup import Tile, heat_table, number, section, text, tiles
from solver_backend.report.page import page_of
from solver_backend.report.plots import PlotCurve, time_plot

MOST_LISTED = 60  # Maximum number of frame ranges in the table.


def labelling_html(name: str, take: LabelledTake, fps: float) -> str:
    """Return the report page about a labelled take as HTML."""
    there = np.isfinite(take.confidence)
    labels = take.labels[there]
    named = (labels >= 0) & (labels < GHOST)
    unknown = labels < 0
    headline = tiles(
        [
            Tile("labelled", number(100 * float(named.mean())), "%", f"{len(set(labels[named].tolist()))} markers"),
            Tile("not on the person", number(100 * float((labels == GHOST).mean())), "%"),
            Tile("unknown", number(100 * float(unknown.mean())), "%", level="look" if unknown.any() else "good"),
            Tile("track segments", str(len(take.tracklets)), "", f"{take.tracklets.num_chains} after joining"),
        ]
    )
    body = [_over_time(take, there, fps), _by_marker(take), _stretches(take, fps)]
    subtitle = f"{len(take.labels)} frames of {take.labels.shape[1]} points at {fps:g} fps, labelled by a network"
    return page_of(f"Labels of {text(name)}", text(subtitle), headline + "".join(body))


def _over_time(take: LabelledTake, there: np.ndarray, fps: float) -> str:
    count = np.maximum(there.sum(1), 1)
    sure = np.nansum(np.where(there, take.confidence, 0.0), axis=1) / count
    unknown = (there & (take.labels < 0)).sum(1) / count
    lines = [PlotCurve(100 * sure, "confidence", "a"), PlotCurve(100 * unknown, "unknown", "quiet")]
    lead = "The plot shows the mean confidence of the labels and the share of points without a label."
    return section("Over time", time_plot(lines, fps, "%", from_zero=True), lead, "time")


def _by_marker(take: LabelledTake) -> str:
    rows, values = [], []
    for label, marker in enumerate(MARKERS):
        mine = take.labels == label
        if mine.any():
            rows.append(marker)
            values.append([100 * mine.any(1).mean(), 100 * take.confidence[mine].mean()])
    if not rows:
        return ""
    table = np.array(values)
    strength = np.clip((100 - table) / 40, 0, 1)
    shown = heat_table(table, rows, ["seen", "confidence"], strength=strength, unit="%")
    return section("Markers", shown, "", "markers")


def _stretches(take: LabelledTake, fps: float) -> str:
    """List the track segments with unknown or uncertain labels. Long and uncertain segments come first."""
    t = take.tracklets
    length = t.last - t.first + 1
    doubt = (1.0 - np.nan_to_num(take.stretch_confidence)) * length
    order = [i for i in np.argsort(-doubt) if take.stretch_label[i] < 0 or take.stretch_confidence[i] < 0.95]
    if not order:
        return section("Frame ranges to check", "<p>none</p>", "", "stretches")
    rows = "".join(
        f"<tr><td>{int(t.column[i])}</td><td>{t.first[i]}–{t.last[i]}</td><td>{number(length[i] / fps, 2)}</td>"
        f"<td>{text(_name(int(take.stretch_label[i])))}</td><td>{number(100 * take.stretch_confidence[i], 0)}</td></tr>"
        for i in order[:MOST_LISTED]
    )
    head = "<tr><th>point</th><th>frames</th><th>seconds</th><th>label</th><th>confidence %</th></tr>"
    lead = "Labels in these frames are unknown or uncertain. Assign them by hand (--labels), and run label again."
    return section("Frame ranges to check", f'<table class="facts">{head}{rows}</table>', lead, "stretches")


def _name(label: int) -> str:
    return "unknown" if label < 0 else "not the person's" if label == GHOST else MARKERS[label]
