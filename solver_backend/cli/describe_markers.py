"""Describe markers and a calibrated person, both as text and as plain values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.hand_markers import hand_labels
from solver_backend.body.marker_layouts import load_layouts
from solver_backend.body.marker_names import is_unnamed, least_markers, name_markers, places_by_side
from solver_backend.body.markers import ON_BONE, marker_landmarks
from solver_backend.exchange.diagnostics import sentence
from solver_backend.fitters.marker_calibration.person_doubts import doubts_of, exchanged_in
from solver_backend.fitters.rest_parts import listed, parts_without
from solver_backend.geometry.marker_jumps import frozen, leaving, neighbours_of
from solver_backend.io.motions.motion_checks import odd_shape
from solver_backend.io.recognition.marker_labels import subjects_of
from solver_backend.types import MarkerCloud, MarkerSubject

MOST_LISTED = 8  # Maximum number of markers listed in a line. Chosen by hand.


def describe_markers(cloud: MarkerCloud) -> tuple[list[str], dict[str, Any]]:
    """Describe a marker recording's subjects, labels, gaps and faults, as text and JSON values."""
    labels = cloud.labels or ()
    named, hands = [label for label in labels if not is_unnamed(label)], hand_labels(labels)
    names = name_markers([label for label in named if label not in hands], places_by_side(cloud))
    count = cloud.positions.shape[1]
    gaps, faults = _gaps(cloud), _faults(cloud)
    groups = {"known": names.known, "of_hands": hands, "unknown": names.unknown, "computed": names.virtual}
    groups = {what: list(group) for what, group in {**groups, "doubled": names.doubled}.items()}
    data: dict[str, Any] = {
        "subjects": list(subjects_of(labels)),
        **groups,
        "unlabelled": count - len(named),
        "gaps": gaps,
        **faults,
    }
    counts = {**{what: len(group) for what, group in groups.items()}, "unlabelled": count - len(named)}
    parts = [f"{number} {what.replace('_', ' ')}" for what, number in counts.items() if number]
    lines = [f"  markers     {count}: {', '.join(parts)}"]
    if data["subjects"]:
        lines.append(f"  subjects    {', '.join(data['subjects'])}")
    if resting := _resting(cloud, names.known):
        data["resting"] = list(resting)
        but = " unless markers with unknown names move with them" if names.unknown else ""
        lines.append(
            f"  at rest     {listed(list(resting))}: they have no known markers and stay at rest in a solve{but}"
        )
    if gaps:
        worst = max(gaps, key=lambda gap: gap["missing_percent"])
        lines.append(
            f"  gaps        {sum(gap['gaps'] for gap in gaps)} in {len(gaps)} markers, most in {worst['marker']}, "
            f"which is hidden in {worst['missing_percent']:g} % of the frames"
        )
    for name, what in (
        (
            "jumping",
            "jump away from all neighbours in single frames or at gaps. A solve checks their labels",
        ),
        ("frozen", "do not move while their neighbours do, and a solve ignores them there"),
    ):
        if marked := faults[name]:
            more = f" and {len(marked) - MOST_LISTED} others" if len(marked) > MOST_LISTED else ""
            lines.append(f"  {name:<11} {len(marked)} markers ({', '.join(marked[:MOST_LISTED])}{more}) {what}")
    return lines, data


def _resting(cloud: MarkerCloud, known: Mapping[str, str]) -> tuple[str, ...]:
    labels = [label for label in cloud.labels or () if label in known]
    if len(labels) < least_markers([known[label] for label in labels]):
        return ()
    columns = [(cloud.labels or ()).index(label) for label in labels]
    body = load_body()
    landmarks = marker_landmarks(body, tuple(known[label] for label in labels))
    return parts_without(body, landmarks, np.isfinite(cloud.positions[:, columns]).all(-1).any(axis=0))


def describe_person(person: MarkerSubject) -> tuple[str, dict[str, Any]]:
    """Describe a calibrated person's shape and marker positions, as text and as JSON values."""
    away = 1000 * np.linalg.norm(person.offsets, axis=-1)
    sigma = 1000 * person.sigma_m
    doubts = [*exchanged_in(person), *doubts_of(person), *odd_shape(person.betas)]
    data = {
        "body": person.body,
        "betas": [round(float(value), 3) for value in person.betas],
        "markers": {
            label: {"place": place, "offset_mm": round(float(offset), 1), "sigma_mm": round(float(spread), 1)}
            for label, place, offset, spread in zip(person.labels, person.places, away, sigma, strict=True)
        },
        "diagnostics": [item.as_dict() for item in doubts],
    }
    free = [" (free along the limb)" if _is_free(place) else "" for place in person.places]
    # Markers attached to a bone have no nominal position.
    named = [m for m in np.argsort(-away, kind="stable") if not person.places[m].startswith(ON_BONE)]
    far = ", ".join(f"{person.labels[m]} {away[m]:.0f} mm{free[m]}" for m in named[:5])
    loose = ", ".join(f"{person.labels[m]} {sigma[m]:.1f} mm" for m in np.argsort(-sigma, kind="stable")[:5])
    lines = [
        f"Calibrated {len(person.labels)} markers on the body {person.body}",
        f"  shape       {', '.join(f'{value:+.2f}' for value in person.betas)}",
        f"  farthest    {far} from their named positions",
        f"  loosest     {loose} around their positions on the body",
    ]
    return "\n".join([*lines, *(f"  warning     {sentence(item)}" for item in doubts)]), data


def _is_free(place: str) -> bool:
    rule = load_layouts().sided.get(place[1:])
    return rule is not None and rule["kind"] == "shaft"


def _faults(cloud: MarkerCloud) -> dict[str, list[str]]:
    if cloud.labels is None or cloud.positions.shape[1] < 2 or len(cloud.positions) < 2:
        return {"jumping": [], "frozen": []}
    around = neighbours_of(cloud.positions)
    found = {
        "jumping": leaving(cloud.positions, around),
        "frozen": frozen(cloud.positions, around, cloud.fps).any(axis=0),
    }
    return {name: [cloud.labels[i] for i in np.flatnonzero(which)] for name, which in found.items()}


def _gaps(cloud: MarkerCloud) -> list[dict[str, Any]]:
    """Return the number of gaps and the percentage of missing frames for each marker with gaps.

    Missing frames at the start and end count as gaps.
    """
    seen = np.isfinite(cloud.positions).all(-1)
    labels = cloud.labels or tuple(f"*{number}" for number in range(1, seen.shape[1] + 1))
    starts = (~seen[:1]).sum(axis=0) + (~seen[1:] & seen[:-1]).sum(axis=0)
    return [
        {"marker": label, "gaps": int(gaps), "missing_percent": round(100 * int(missing) / len(seen), 1)}
        for label, gaps, missing in zip(labels, starts, (~seen).sum(axis=0), strict=True)
        if gaps
    ]
