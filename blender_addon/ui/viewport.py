"""Draw marker names, cameras and confidence in the viewport and on the timeline."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import bpy
from bpy.app.handlers import persistent

from .._exchange.errors import MocapError
from ..conventions.skeleton import layout_of

if TYPE_CHECKING:
    import numpy as np
    from mathutils import Matrix, Vector

    from ..review.ghost import Ghost

_OFFSET_PX, _SIZE_PX = 7, 11  # Distance between a point and its name, and the height of the name, in pixels.
_PLAIN, _UNKNOWN = (0.9, 0.9, 0.95, 1.0), (1.0, 0.5, 0.2, 1.0)
GOOD, SUSPECT, UNUSED = (0.25, 0.8, 0.35, 1.0), (1.0, 0.5, 0.2, 1.0), (0.5, 0.5, 0.5, 0.6)
"""Colours of cameras, by how they are used."""
_WIDTH_PX, _CONTROL_PX = 2.0, 1.5
_EDGES = (0, 1, 1, 2, 2, 3, 3, 0)
"""Image corners that the drawn edges connect, as pairs in one list."""
_OFF_SKIN_M, _OPACITY = 0.002, 0.9  # Gap that keeps the skin from hiding its colours, in metres, and their opacity.
_AMBIENT = 0.4  # Brightness of skin seen edge-on (0 to 1). It makes the body's shape visible.
_BAND_PX = 5.0  # Height of a band on the timeline in pixels.


def draw_names() -> None:
    """Draw the markers' names in the viewport. Unknown names are orange."""
    for capture in bpy.context.scene.mocap.captures:
        if capture.show_names and capture.cloud is not None and capture.cloud.visible_get():
            _draw_names(bpy.context, capture)


def _draw_names(context: bpy.types.Context, capture: bpy.types.PropertyGroup) -> None:
    import blf

    scale = context.preferences.system.ui_scale
    known = {item.name for item in capture.marker_items if item.meaning == "known"}
    blf.size(0, _SIZE_PX * scale)
    for label, (x, y) in name_places(context, capture.cloud).items():
        blf.color(0, *(_PLAIN if label in known else _UNKNOWN))
        blf.position(0, x + _OFFSET_PX * scale, y, 0)
        blf.draw(0, label.rpartition(":")[2])


def name_places(context: bpy.types.Context, cloud: bpy.types.Object) -> dict[str, tuple[float, float]]:
    """Return each marker's position in the viewport in pixels, keyed by its label."""
    from bpy_extras.view3d_utils import location_3d_to_region_2d
    from mathutils import Vector

    from ..scene.overlay import marker_positions

    found = {}
    for label, point in marker_positions(cloud, context.scene.frame_current_final).items():
        place = location_3d_to_region_2d(context.region, context.region_data, cloud.matrix_world @ Vector(point))
        if place is not None:
            found[label] = (place.x, place.y)
    return found


def colour_markers(scene: bpy.types.Scene) -> None:
    """Colour the markers by their distance from the solved body, or all in one colour."""
    capture, take = scene.mocap.capture, scene.mocap.review.take
    if capture.cloud is None:
        return
    from .._exchange.motion_file import read_motion
    from ..animation.takes import take_file
    from ..scene.overlay import grade_markers

    motion = None
    if capture.show_residuals and take is not None:
        try:
            motion = read_motion(take_file(take, "motion_file"))
        except MocapError:
            motion = None  # the take's file no longer exists
    grade_markers(capture.cloud, motion)


def _draw(kind: str, primitive: str, content: dict[str, Any], uniforms: dict[str, Any], indices: Any = None) -> None:
    import gpu
    from gpu_extras.batch import batch_for_shader

    shader = gpu.shader.from_builtin(kind)
    batch = batch_for_shader(shader, primitive, content, indices=indices)
    for name, value in uniforms.items():
        shader.uniform_float(name, value)
    batch.draw(shader)


def _draw_cameras() -> None:
    context = bpy.context
    width = _WIDTH_PX * context.preferences.system.ui_scale
    fixed = {"viewportSize": (context.region.width, context.region.height), "lineWidth": width}
    for camera, shade in shaded_cameras(context):
        _draw("POLYLINE_UNIFORM_COLOR", "LINES", {"pos": outline(camera, context.scene)}, {**fixed, "color": shade})


def shaded_cameras(context: bpy.types.Context) -> Iterator[tuple[bpy.types.Object, tuple[float, ...]]]:
    """Yield each visible camera and its outline colour, but not the scene's active camera."""
    for capture in context.scene.mocap.captures:
        for item in capture.cameras if capture.show_agreement else ():
            camera = item.object
            if camera is not None and camera.visible_get() and camera != context.scene.camera:
                yield camera, shade_of(capture, item)


def shade_of(capture: bpy.types.PropertyGroup, item: bpy.types.PropertyGroup) -> tuple[float, ...]:
    """Return the outline colour of a camera: unused, suspect (named in a problem) or good."""
    if not item.use:
        return UNUSED
    return SUSPECT if item.name in capture.suspect_cameras else GOOD


def outline(camera: bpy.types.Object, scene: bpy.types.Scene) -> list[Vector]:
    """Return the line end points of a camera's pyramid in world coordinates, in pairs."""
    corners = [camera.matrix_world @ corner for corner in camera.data.view_frame(scene=scene)]
    place = camera.matrix_world.translation
    return [corners[i] for i in _EDGES] + [end for corner in corners for end in (place, corner)]


weights: dict[tuple[str, int], np.ndarray] = {}  # Joint weights of skins, by mesh name and number of vertices.


def _reviews_of(scene: bpy.types.Scene) -> list[bpy.types.PropertyGroup]:
    reviews = [review for capture in scene.mocap.captures for review in capture.reviews]
    return [item for item in reviews if item.armature is not None and item.armature.type == "ARMATURE"]


def _shown_reviews(scene: bpy.types.Scene) -> list[bpy.types.PropertyGroup]:
    return [review for review in _reviews_of(scene) if review.colours]


def _draw_skins() -> None:
    from ..body.shape import body_mesh

    context = bpy.context
    for review in _shown_reviews(context.scene):
        skin = body_mesh(review.armature)
        if skin is not None and skin.visible_get(view_layer=context.view_layer):
            _draw_skin(context, review.armature, skin)


def _draw_skin(context: bpy.types.Context, armature: bpy.types.Object, skin: bpy.types.Object) -> None:
    from ..animation.lanes import current_confidence, resting_bones
    from ..review.ranges import joint_weights, skin_colours

    posed = skin.evaluated_get(context.evaluated_depsgraph_get())
    count, joints = len(skin.data.vertices), layout_of(armature.data.bones).joints
    if len(posed.data.vertices) != count:
        return  # one of the user's modifiers changes the vertices, so the weights no longer match
    key = (skin.data.name_full, count)
    if key not in weights:
        weights[key] = joint_weights(skin, joints)
    resting = resting_bones(armature, context.scene.frame_current)
    _draw_coloured(posed, skin_colours(weights[key], joints, current_confidence(armature), resting))


def _draw_bands() -> None:
    from ..review.ranges import doubtful_bands

    context = bpy.context
    view, height = context.region.view2d, _BAND_PX * context.preferences.system.ui_scale
    for review in _shown_reviews(context.scene):
        if review.take is None:
            continue
        for first, last, shade in doubtful_bands(review.take, review.below):
            left, right = (view.view_to_region(frame, 0.0, clip=False)[0] for frame in (first - 0.5, last + 0.5))
            right = max(float(right), left + 2.0)
            corners = {"pos": [(left, 0.0), (right, 0.0), (right, height), (left, height)]}
            _draw("UNIFORM_COLOR", "TRIS", corners, {"color": (*shade, 1.0)}, [(0, 1, 2), (0, 2, 3)])


def _draw_coloured(posed: bpy.types.Object, shades: np.ndarray) -> None:
    """Draw an evaluated mesh in vertex colours (V, 3), slightly in front of its surface."""
    import numpy as np

    from ..body.mesh import positions

    mesh, count = posed.data, len(shades)
    normals = np.empty(3 * count, np.float32)
    mesh.vertex_normals.foreach_get("vector", normals)
    mesh.calc_loop_triangles()
    triangles = np.empty(3 * len(mesh.loop_triangles), np.int32)
    mesh.loop_triangles.foreach_get("vertices", triangles)
    normals = normals.reshape(-1, 3)
    to_viewer = np.array(bpy.context.region_data.view_rotation.to_matrix(), np.float32)[:, 2]
    turn = np.array(posed.matrix_world.to_3x3().normalized(), np.float32)
    lit = _AMBIENT + (1 - _AMBIENT) * np.abs(normals @ (turn.T @ to_viewer))
    colour = np.column_stack([shades * lit[:, None], np.full(count, _OPACITY)]).astype(np.float32)
    points = positions(mesh.vertices) + _OFF_SKIN_M * normals
    _draw_skin_of(points, colour, triangles.reshape(-1, 3), posed.matrix_world)


def _draw_skin_of(points: np.ndarray, colours: np.ndarray, triangles: np.ndarray, world: Matrix | None = None) -> None:
    """Draw points (V, 3) in colours (V, 4) where no object occludes them."""
    import gpu

    gpu.state.blend_set("ALPHA")
    gpu.state.depth_test_set("LESS_EQUAL")
    gpu.state.face_culling_set("BACK")
    with gpu.matrix.push_pop():
        if world is not None:
            gpu.matrix.multiply_matrix(world)
        _draw("SMOOTH_COLOR", "TRIS", {"pos": points, "color": colours}, {}, triangles)
    gpu.state.face_culling_set("NONE")
    gpu.state.depth_test_set("NONE")
    gpu.state.blend_set("NONE")


def has_grey_controls(context: bpy.types.Context, armature: bpy.types.Object) -> bool:
    """Return whether Blender draws a body's control bones in grey."""
    overlay, shown = context.space_data.overlay, armature.data.show_bone_custom_shapes
    if not (shown and overlay.show_overlays and overlay.show_bones and armature.visible_get()):
        return False
    return armature.mode == "OBJECT" and not armature.select_get()


def _draw_controls() -> None:
    import gpu

    from ..body.controls.shapes import shape_lines

    context = bpy.context
    width = _CONTROL_PX * context.preferences.system.ui_scale
    fixed = {"viewportSize": (context.region.width, context.region.height), "lineWidth": width}
    for review in _reviews_of(context.scene):
        if not has_grey_controls(context, review.armature):
            continue
        gpu.state.depth_test_set("NONE" if review.armature.show_in_front else "LESS_EQUAL")
        for colour, lines in shape_lines(review.armature).items():
            _draw("POLYLINE_UNIFORM_COLOR", "LINES", {"pos": lines}, {**fixed, "color": (*colour, 1.0)})
        gpu.state.depth_test_set("NONE")


ghosts: list[Ghost] = []
"""The ghost that the viewports show. The list has at most one element."""


def ghost_of(review: bpy.types.PropertyGroup) -> Ghost | None:
    """Return a body's ghost, or None if it has none or if the ghost's take is the current one or was deleted."""
    armature, take = review.armature, review.take
    shown = next((ghost for ghost in ghosts if armature is not None and ghost.armature == armature.session_uid), None)
    if shown is None or take is None or shown.take == take.session_uid:
        return None
    return shown if any(action.session_uid == shown.take for action in bpy.data.actions) else None


def _draw_ghosts() -> None:
    import numpy as np

    from ..review.ghost import shaded

    context = bpy.context
    for review in _reviews_of(context.scene) if ghosts else ():
        ghost = ghost_of(review)
        if ghost is not None and review.armature.visible_get(view_layer=context.view_layer):
            points = ghost.skin(context.scene.frame_current_final).astype(np.float32)
            eye = np.array(context.region_data.view_rotation.to_matrix(), np.float32)[:, 2]
            _draw_skin_of(points, shaded(points, ghost.body.faces, eye), ghost.body.faces.astype(np.int32))


HANDLERS = (
    (bpy.types.SpaceView3D, draw_names, "POST_PIXEL"),
    (bpy.types.SpaceView3D, _draw_cameras, "POST_VIEW"),
    (bpy.types.SpaceView3D, _draw_skins, "POST_VIEW"),
    (bpy.types.SpaceView3D, _draw_ghosts, "POST_VIEW"),
    (bpy.types.SpaceView3D, _draw_controls, "POST_VIEW"),
    (bpy.types.SpaceDopeSheetEditor, _draw_bands, "POST_PIXEL"),
)
"""Space, function and event of each draw handler."""


def colour_bones(scene: bpy.types.Scene) -> None:
    """Colour the bodies' bones by confidence, or remove these colours."""
    from ..review.ranges import paint_bones

    for review in _reviews_of(scene):
        paint_bones(review.armature, scene.frame_current, shown=review.colours)


@persistent
def on_frame_change(scene: bpy.types.Scene, *_: object) -> None:
    """Colour bones before Blender evaluates the new frame, so that it needs only one evaluation."""
    colours = any(review.colours for capture in scene.mocap.captures for review in capture.reviews)
    if colours and not bpy.app.is_job_running("RENDER"):
        colour_bones(scene)
