"""Draw the diagrams of docs/explanation/method.md with the solver's own curve functions."""

from __future__ import annotations

from functools import cache

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.geometry.interpolation import sider_n
from solver_backend.geometry.rotations import exp_so3
from solver_backend.priors.sposer import load_sposer
from solver_backend.residuals.terms import geman_mcclure
from solver_backend.synthesis.embedded.demo import demo_capture
from supply.svg_parts import ACCENT, INK, QUIET, WARM, arrow, box, dot, ellipse, picture, polyline, text

_KEY_FRAMES = (14, 40, 66)  # Frames of the demo with the person standing, bending and squatting.
_FIGURES = 7
_FARTHEST = 12.0
"""Largest distance in the chart of the robust weight, in standard deviations."""
_LIMBS = (
    SMPL.group("trunk"),
    *((0, *SMPL.group(f"{side}_leg")) for side in ("left", "right")),
    *((*SMPL.numbers("spine3"), *SMPL.group(f"{side}_arm"), *SMPL.group(f"{side}_hand")) for side in ("left", "right")),
)
"""Chains of the body's 24 joints: trunk, legs, arms."""


def pipeline() -> str:
    """Draw the steps from input data to an animated body."""
    given = [("Videos", "detector"), ("Detections", "OpenPose, …"), ("Markers", "C3D, TRC, CSV"), ("Sensors", "depth")]
    parts = [box(16, 20 + 58 * row, 112, 46, words) for row, words in enumerate(given)]
    parts += [arrow((128, 43 + 58 * row), (150, 43 + 58 * row), (150, 130), (166, 130)) for row in range(4)]
    steps = [
        ("Read", "one Capture"),
        ("Check views", "delays, turns,", "exchanges"),
        ("Start", "lifter,", "single frames"),
    ]
    for column, words in enumerate(steps):
        parts += [box(168 + 122 * column, 98, 102, 64, words)]
        parts += [arrow((270 + 122 * column, 130), (288 + 122 * column, 130))]
    parts += [box(534, 98, 170, 64, ("Bundle", "all keyframes at once,", "Gauss-Newton"), ACCENT)]
    parts += [box(534, 18, 170, 50, ("Learn", "shape, noise, contacts"), ACCENT)]
    parts += [arrow((590, 98), (590, 70)), arrow((648, 68), (648, 96))]
    parts += [box(534, 192, 170, 60, ("Check the result", "covariance, flags,", "diagnostics"), ACCENT)]
    parts += [arrow((619, 162), (619, 190)), arrow((534, 222), (508, 222))]
    parts += [box(336, 192, 170, 60, ("Motion file", "poses, shape, deviations"), WARM), arrow((336, 222), (310, 222))]
    parts += [box(168, 192, 140, 60, ("Blender", "body, action, export"), WARM)]
    return picture("From videos, detections, markers or sensors to an animated body", 270, parts)


def prior() -> str:
    """Draw keys on the sphere of codes, the curve between them, and the decoded poses."""
    keys, times = np.array([[-0.75, -0.25, 0.61], [0.1, 0.55, 0.83], [0.72, -0.2, 0.66]]), np.linspace(0, 1, 41)
    keys /= np.linalg.norm(keys, axis=1, keepdims=True)
    curve = np.asarray(sider_n(np.broadcast_to(keys, (41, 3, 3)), times))
    centre, radius = np.array([130.0, 130.0]), 96.0
    flat = centre + radius * curve[:, :2] * (1, -1)
    parts = [dot(centre, radius, QUIET, hollow=True)]
    for height in (-0.5, 0.0, 0.5):
        turn, ring = np.linspace(0, 2 * np.pi, 49), np.sqrt(1 - height**2)
        parts += [
            polyline(
                centre + radius * np.stack([ring * np.cos(turn), -height + 0.25 * ring * np.sin(turn)], 1), QUIET, 0.6
            )
        ]
    parts += [polyline(centre + radius * keys[:, :2] * (1, -1), WARM, 1.5, dashed=True), polyline(flat, ACCENT, 3)]
    parts += [dot(centre + radius * key[:2] * (1, -1), 6, ACCENT) for key in keys]
    parts += [text(x, y, name, "b") for x, y, name in ((42, 176, "z₁"), (134, 66, "z₂"), (206, 172, "z₃"))]
    parts += [
        text(130, 250, "codes: unit vectors of R³²", "m s"),
        arrow((240, 120), (282, 120)),
        text(261, 110, "decoder", "m s"),
    ]
    figures = _decoded_poses()
    for column, joints in enumerate(figures):
        place = np.array([322 + 57 * column, 112])
        is_key = column in (0, _FIGURES // 2, _FIGURES - 1)
        for chain in _LIMBS:
            parts += [
                polyline(place + 84 * joints[list(chain)] * (1, -1), ACCENT if is_key else QUIET, 3 if is_key else 2)
            ]
    parts += [text(500, 232, "poses between three keys, one code each", "m s")]
    parts += [text(500, 250, "blue keys, grey poses on the curve, dashed lines off the sphere", "m s")]
    return picture(
        "The pose prior: a curve between three codes on a sphere, and the poses that it decodes to", 268, parts
    )


def bundle() -> str:
    """Draw keys over time, the parabolas of the windows, and the banded matrix."""
    layout = KeyframeLayout(np.array([0, 14, 24, 31, 38, 48, 62]))
    frames = np.arange(63)
    course = lambda t: 96 - 46 * np.sin((t - 4) / 8.6) * np.exp(-(((t - 33) / 22) ** 2))  # noqa: E731 - a drawing's curve
    x = lambda t: 26 + 6.6 * t  # noqa: E731
    parts = [text(26, 24, "one coordinate of the pose", "s"), polyline([(x(0), 166), (x(62) + 8, 166)], INK, 1)]
    noise = np.random.default_rng(3).normal(0, 6, (2, 63))
    parts += [dot((x(f), course(f) + n), 1.6, WARM) for row in noise for f, n in zip(frames, row, strict=True)]
    window, place = layout.positions(np.linspace(0, 62, 249))
    heights = course(layout.key_times)
    a, b, c = heights[2 * window], heights[2 * window + 1], heights[2 * window + 2]
    values = a * (1 - place) * (1 - 2 * place) + 4 * b * place * (1 - place) + c * place * (2 * place - 1)
    parts += [polyline(np.stack([x(np.linspace(0, 62, 249)), values], 1), ACCENT, 2.5)]
    parts += [polyline([(x(bound), 150), (x(bound), 172)], QUIET, 1.5) for bound in layout.bounds]
    parts += [
        dot((x(t), h), 4.5, ACCENT, hollow=bool(k % 2))
        for k, (t, h) in enumerate(zip(layout.key_times, heights, strict=True))
    ]
    parts += [text(x(31), 190, "frames, divided into windows that are shorter in fast motion", "m s")]
    parts += [
        dot((40, 212), 4.5, ACCENT),
        text(50, 216, "key shared by two windows", "s"),
        dot((222, 212), 4.5, ACCENT, hollow=True),
    ]
    parts += [text(232, 216, "key within a window", "s"), dot((366, 212), 2, WARM), text(374, 216, "detections", "s")]
    side, left, top = 11, 510, 36
    for row in range(layout.num_keys):
        for column in range(layout.num_keys):
            if any(max(row, column) <= 2 * w + 2 and min(row, column) >= 2 * w for w in range(layout.num_windows)):
                fill = ACCENT if row == column else QUIET
                parts.append(
                    f'<rect x="{left + side * column}" y="{top + side * row}" width="10" height="10" fill="{fill}"/>'
                )
    parts += [text(left, 24, "normal equations", "s"), text(left, 196, "one block per key. Windows share", "s")]
    parts += [text(left, 212, "one key, so the matrix is banded", "s")]
    return picture("Keyframes over time, the curves between them, and the banded normal equations", 232, parts)


def noise() -> str:
    """Draw the combination of views in one information matrix, and the robust weight."""
    point, parts = (190.0, 118.0), [text(20, 24, "three views of one keypoint", "s")]
    for (x, y), sigma, name in (((40, 56), 9.0, "sharp"), ((60, 206), 16.0, "usual"), ((338, 60), 30.0, "noisy")):
        along = np.array(point) - (x, y)
        angle, across = np.degrees(np.arctan2(along[1], along[0])), np.array([-along[1], along[0]]) / np.hypot(*along)
        far = np.array(point) + 0.32 * along
        edges = [np.array((x, y)), far + sigma * across, far - sigma * across]
        path = " ".join(f"{u:.1f},{v:.1f}" for u, v in edges)
        parts += [f'<polygon points="{path}" fill="{WARM}" fill-opacity="0.18"/>', polyline(((x, y), far), WARM, 1.2)]
        parts += [
            f'<rect x="{x - 8}" y="{y - 6}" width="16" height="12" rx="2" fill="{INK}" '
            f'transform="rotate({angle:.0f} {x} {y})"/>'
        ]
        parts += [text(x, y - 14, name, "m s")]
    parts += [ellipse(*point, (17, 9), 28, ACCENT), dot(point, 3, ACCENT)]
    parts += [text(190, 236, "Σ wᵢ Jᵢᵀ Jᵢ: one 3 × 3 matrix for any number of cameras", "m s")]
    left, bottom, wide, high = 440, 190, 250, 140
    r, last = np.linspace(0, _FARTHEST, 81), SolveSettings().robust_scale
    for scale, colour, name, at in ((4 * last, QUIET, "first pass", 48), (last, ACCENT, "last pass", 22)):
        weight = geman_mcclure(r**2, scale)[1]
        parts += [polyline(np.stack([left + wide * r / _FARTHEST, bottom - high * weight], 1), colour, 2.5)]
        parts += [text(left + wide * r[at] / _FARTHEST + 8, bottom - high * weight[at] - 4, name, "s")]
    parts += [polyline([(left, bottom - high - 8), (left, bottom), (left + wide, bottom)], INK, 1)]
    parts += [
        text(left, 24, "weight of a detection", "s"),
        text(left - 6, bottom - high + 4, "1", "s").replace('class="s"', 'class="s" text-anchor="end"'),
    ]
    parts += [text(left + wide / 2, 212, "distance from the body, in its own standard deviations", "m s")]
    parts += [text(left + wide / 2, 236, "σ is learned for every keypoint in every view", "m s")]
    return picture("Noise: views weighted by their own deviation, and the robust weight of a detection", 252, parts)


def markers() -> str:
    """Draw the steps from optical markers to a body."""
    steps = [
        ("Points", "with labels, some", "or none"),
        ("Label", "network, distances,", "votes of stretches"),
        ("Calibrate", "shape, and each", "marker's own place"),
        ("Bundle", "as for views, with", "spread by marker"),
    ]
    parts = []
    for column, words in enumerate(steps):
        x = 16 + 178 * column
        parts += [box(x, 34, 154, 70, words, QUIET if column == 0 else ACCENT)]
        parts += [arrow((x + 154, 69), (x + 176, 69))] if column < 3 else []
    parts += [arrow((627, 104), (627, 150)), box(550, 152, 154, 62, ("Body and joints", "with deviations"), WARM)]
    parts += [
        arrow((550, 183), (530, 183)),
        box(372, 152, 156, 62, ("Clean markers", "gaps filled, labels", "corrected"), WARM),
    ]
    parts += [
        box(194, 152, 154, 62, ("Props", "rigid sets that no", "bone carries"), WARM),
        arrow((271, 104), (271, 150)),
    ]
    parts += [
        arrow((449, 104), (449, 128), (93, 128), (93, 150)),
        box(16, 152, 154, 62, ("Subject file", "for all takes of", "the person"), WARM),
    ]
    return picture("From optical markers to a body: label, calibrate, solve, and the results", 232, parts)


@cache
def _decoded_poses() -> tuple[np.ndarray, ...]:
    """Return (24, 2) joints, in metres, of poses interpolated between three demo poses, seen from the front left."""
    prior, body = load_sposer(), load_body()
    poses = np.asarray(demo_capture().truth["body_pose"])[list(_KEY_FRAMES)]
    poses = poses[:, : 3 * SMPL.num_solved].reshape(len(_KEY_FRAMES), SMPL.num_solved, 3)
    keys = np.asarray(prior.encode(exp_so3(poses)))
    codes = sider_n(np.broadcast_to(keys, (_FIGURES, *keys.shape)), np.linspace(0, 1, _FIGURES))
    return tuple(_joints(rotations, body) for rotations in np.asarray(prior.decode(codes)))


def _joints(rotations: np.ndarray, body: object) -> np.ndarray:
    rest, parents = np.asarray(body.joints_template), body.parents  # type: ignore[attr-defined]
    turns, places = [np.eye(3)], [rest[0] * 0]
    for joint in range(1, len(rest)):
        parent = parents[joint]
        places.append(places[parent] + turns[parent] @ (rest[joint] - rest[parent]))
        turns.append(turns[parent] @ (rotations[joint - 1] if joint <= len(rotations) else np.eye(3)))
    across = np.array([0.77, 0.0, 0.64])
    return np.array(places) @ np.stack([across, [0, 1, 0]], axis=1)


DIAGRAMS = {"pipeline": pipeline, "prior": prior, "bundle": bundle, "noise": noise, "markers": markers}
"""Function that draws each diagram, by its name in docs/images (``method_NAME.svg``)."""
