"""Through real pixels and back: an axis or half a pixel that slips anywhere fails here."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from solver_backend.cameras.projection import project
from solver_backend.synthesis.studio.make_shot import film
from solver_backend.synthesis.studio.sensor_pictures import (
    InfraredModel,
    Seen,
    TimeOfFlightModel,
    measure_depth,
    sphere_light,
)
from solver_backend.synthesis.studio.spec import Spec, spec_of
from solver_backend.synthesis.studio.stage import Stage, list_shots, set_up
from solver_backend.synthesis.studio.z_buffer import see_spheres
from tests.support.blob_reading import lift, sightings, triangulated


@cache
def filmed(
    array: str, frames: int, furniture: int = 0
) -> tuple[Spec, Stage, dict[tuple[str, int, int], np.ndarray], np.ndarray]:
    spec = spec_of(
        {
            "camera_arrays": [array],
            "frames": frames,
            "fps": 4,
            "looks": [{"preset": "suit", "furniture": furniture}],
            "seed": 3,
        }
    )
    stage = set_up(spec, list_shots(spec)[0])
    pictures: dict[tuple[str, int, int], np.ndarray] = {}

    def keep(kind: str, view: int, frame: int, picture: np.ndarray) -> None:
        pictures[kind, view, frame] = picture

    return spec, stage, pictures, film(spec, stage, keep)


def matched(
    stage: Stage, view: int, frame: int, blobs: np.ndarray, seen: np.ndarray, alone_px: float
) -> dict[int, int]:
    """Return the blob of each marker that is wholly seen and has no other marker near it."""
    cameras = stage.cameras
    px = project(cameras, stage.markers[frame])[view]
    apart = np.linalg.norm(px[:, None] - px[None], axis=-1) + 1e6 * np.eye(len(px))
    found = {}
    for marker in np.flatnonzero((seen > 0.999) & (apart.min(axis=1) > alone_px)).tolist():
        distance = np.linalg.norm(blobs - px[marker], axis=1)
        assert distance.min() < 2.0, (view, frame, stage.labels[marker], distance.min())
        found[marker] = int(distance.argmin())
    return found


@pytest.mark.slow
def test_blobs_triangulated_with_the_written_cameras_meet_the_markers_within_a_millimetre() -> None:
    _, stage, pictures, seen = filmed("vicon_12", 1)
    rays: dict[tuple[int, int], list[tuple[int, np.ndarray]]] = {}
    for frame in range(stage.num_frames):
        for view in range(len(stage.cameras)):
            blobs = sightings(stage.cameras, view, pictures["infrared", view, frame]).px
            for marker, blob in matched(stage, view, frame, blobs, seen[view, frame], 14.0).items():
                rays.setdefault((frame, marker), []).append((view, blobs[blob]))
    error = np.array([
        1e3 * np.linalg.norm(
            triangulated(stage.cameras, [v for v, _ in found], np.array([xy for _, xy in found]))
            - stage.markers[frame, marker]
        )
        for (frame, marker), found in rays.items() if len(found) >= 3
    ])  # fmt: skip
    assert len(error) > 25
    assert np.sqrt((error**2).mean()) < 0.5
    assert error.max() < 1.0


@pytest.mark.slow
def test_ring_and_median_of_three_depth_sensors_give_markers_within_four_millimetres() -> None:
    _, stage, pictures, seen = filmed("azure_kinect_3", 6)
    points: dict[tuple[int, int], list[np.ndarray]] = {}
    for frame in range(stage.num_frames):
        for view in range(3):
            infrared, depth = pictures["infrared", view, frame], pictures["depth", view, frame]
            seen_here = sightings(stage.cameras, view, infrared, depth)
            for marker, blob in matched(stage, view, frame, seen_here.px, seen[view, frame], 10.0).items():
                centre = np.round(seen_here.px[blob]).astype(int)
                assert depth[centre[1], centre[0]] == 0, "the patch is blind"
                points.setdefault((frame, marker), []).append(seen_here.points[blob])
    off = np.array([np.mean(p, axis=0) - stage.markers[key] for key, p in points.items() if np.isfinite(p).all()])
    assert len(off) > 120
    error = 1e3 * np.linalg.norm(off, axis=1)
    assert np.sqrt((error**2).mean()) < 4.0
    assert np.median(error) < 2.5


@pytest.mark.slow
def test_depth_of_the_room_is_true_within_its_noise() -> None:
    _, stage, pictures, _ = filmed("azure_kinect_3", 6)
    cameras, low, high = stage.cameras, stage.room.low, stage.room.high
    u, v = np.meshgrid(np.arange(640.0), np.arange(576.0))
    px = np.stack([u, v], axis=-1).reshape(-1, 2)
    for view in range(3):
        depth, label = pictures["depth", view, 0], pictures["masks", view, 0]
        chosen = (label == 9).ravel() & (depth.ravel() > 0)
        points = lift(cameras, view, px[chosen], depth.ravel()[chosen] / 1000.0)
        off = np.minimum(np.abs(points - low), np.abs(points - high)).min(axis=1)
        far = depth.ravel()[chosen] / 1000.0
        sigma = TimeOfFlightModel().sigma_m(far)
        # Flying pixels apart, a point lies on a plane to within its noise, which grazing sight makes larger.
        assert np.median(off / sigma) < 0.75
        assert (off < 5 * sigma).mean() > 0.97


@pytest.mark.slow
@pytest.mark.parametrize("distance", [1.0, 2.0, 3.5])
def test_noise_of_a_wall_is_the_models(distance: float) -> None:
    shape, model = (200, 300), TimeOfFlightModel()
    wall = np.full(shape, distance, np.float32)
    cameras = filmed("azure_kinect_3", 6)[1].cameras
    nobody = see_spheres(cameras, 0, np.zeros((0, 3)), wall)
    seen = Seen(wall, np.zeros(shape, np.uint8), np.ones(shape, np.float32), None, nobody)
    found = measure_depth(seen, np.zeros(shape, np.float32), model, np.random.default_rng(0))
    error = found / 1000.0 - distance
    expected = np.hypot(model.sigma_m(np.array(distance)), 0.001 / np.sqrt(12))
    assert error.std() == pytest.approx(expected, rel=0.02)
    assert abs(error.mean()) < 5e-5


def test_a_marker_behind_a_wall_sends_nothing_back() -> None:
    stage = filmed("azure_kinect_3", 6)[1]
    wall = np.full((576, 640), 0.5, np.float32)
    spheres = see_spheres(stage.cameras, 0, stage.markers[0], wall)
    assert not spheres.seen.any()
    assert not sphere_light(spheres, wall.shape, InfraredModel()).any()


def test_a_sphere_covers_its_disc() -> None:
    stage = filmed("azure_kinect_3", 6)[1]
    free = np.full((576, 640), np.inf, np.float32)
    spheres = see_spheres(stage.cameras, 1, stage.markers[0], free)
    for marker in range(len(stage.labels)):
        area = spheres.cover[spheres.owner == marker].sum()
        assert area == pytest.approx(np.pi * spheres.radius_px[marker] ** 2, rel=0.06)
    assert (spheres.seen > 0.999).all()
