"""Confidence where an animator looks: the skin coloured in the viewport, doubtful frames marked on the timeline."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import bpy

if TYPE_CHECKING:
    import numpy as np

_OFF_SKIN_M, _OPACITY = 0.002, 0.9
"""The colours stand off the skin by this, so that the skin does not shine through."""
_BAND_PX = 5.0
"""Height of a band on the timeline."""


class ConfidenceDrawing:
    """The editors' draw handlers, there while the add-on is switched on; what a body's skin is led by is kept."""

    def __init__(self) -> None:
        self._handles: list[tuple[Any, Any]] = []
        self._weights: dict[tuple[str, int], np.ndarray] = {}

    def start(self) -> None:
        """Draw from now on."""
        views = ((bpy.types.SpaceView3D, self._draw_skins, "POST_VIEW"),)
        lines = ((bpy.types.SpaceDopeSheetEditor, self._draw_bands, "POST_PIXEL"),)
        for space, draw, when in (*views, *lines):
            self._handles.append((space, space.draw_handler_add(draw, (), "WINDOW", when)))

    def stop(self) -> None:
        """Draw no longer."""
        for space, handle in self._handles:
            space.draw_handler_remove(handle, "WINDOW")
        self._handles, self._weights = [], {}

    def _draw_skins(self) -> None:
        """Draw the bodies whose confidence is shown into the viewport being drawn."""
        from ..body.shape import body_mesh

        context = bpy.context
        for review in shown_reviews(context.scene):
            skin = body_mesh(review.armature)
            if skin is not None and skin.visible_get(view_layer=context.view_layer):
                self._draw_skin(context, review.armature, skin)

    def _draw_skin(self, context: bpy.types.Context, armature: bpy.types.Object, skin: bpy.types.Object) -> None:
        from ..animation.lanes import current_confidence, resting_bones
        from ..conventions.skeleton import layout_of
        from ..review.skin_colours import joint_weights, skin_colours

        posed = skin.evaluated_get(context.evaluated_depsgraph_get())
        count, joints = len(skin.data.vertices), layout_of(armature.data.bones).joints
        if len(posed.data.vertices) != count:
            return  # a modifier of the user's: the skin is no longer the one whose weights are known
        key = (skin.data.name_full, count)
        if key not in self._weights:
            self._weights[key] = joint_weights(skin, joints)
        resting = resting_bones(armature, context.scene.frame_current)
        shades = skin_colours(self._weights[key], joints, current_confidence(armature), resting)
        draw_coloured(posed, shades)

    def _draw_bands(self) -> None:
        """Draw a band under the doubtful frames of the takes whose confidence is shown."""
        from ..review.skin_colours import doubtful_bands

        context = bpy.context
        view, height = context.region.view2d, _BAND_PX * context.preferences.system.ui_scale
        for review in shown_reviews(context.scene):
            if review.take is None:
                continue
            for first, last, shade in doubtful_bands(review.take, review.below):
                left, right = (view.view_to_region(frame, 0.0, clip=False)[0] for frame in (first - 0.5, last + 0.5))
                draw_band(left, max(float(right), left + 2.0), height, shade)


drawing = ConfidenceDrawing()


def shown_reviews(scene: bpy.types.Scene) -> Iterator[bpy.types.PropertyGroup]:
    """Yield the reviews whose confidence is shown."""
    for capture in scene.mocap.captures:
        for review in capture.reviews:
            if review.colours and review.armature is not None and review.armature.type == "ARMATURE":
                yield review


def draw_coloured(posed: bpy.types.Object, shades: np.ndarray) -> None:
    """Draw an evaluated mesh in colours of its vertices, a little off its surface.

    Args:
        posed: the evaluated object.
        shades: (V, 3) colours.
    """
    import gpu  # pyright: ignore[reportMissingImports]
    import numpy as np
    from gpu_extras.batch import batch_for_shader  # pyright: ignore[reportMissingImports]

    mesh, count = posed.data, len(shades)
    places, normals = np.empty(3 * count, np.float32), np.empty(3 * count, np.float32)
    mesh.vertices.foreach_get("co", places)
    mesh.vertex_normals.foreach_get("vector", normals)
    mesh.calc_loop_triangles()
    triangles = np.empty(3 * len(mesh.loop_triangles), np.int32)
    mesh.loop_triangles.foreach_get("vertices", triangles)
    colour = np.column_stack([shades, np.full(count, _OPACITY)]).astype(np.float32)
    shader = gpu.shader.from_builtin("SMOOTH_COLOR")
    content = {"pos": (places + _OFF_SKIN_M * normals).reshape(-1, 3), "color": colour}
    batch = batch_for_shader(shader, "TRIS", content, indices=triangles.reshape(-1, 3))
    gpu.state.blend_set("ALPHA")
    gpu.state.depth_test_set("LESS_EQUAL")
    gpu.state.face_culling_set("BACK")
    with gpu.matrix.push_pop():
        gpu.matrix.multiply_matrix(posed.matrix_world)
        batch.draw(shader)
    gpu.state.face_culling_set("NONE")
    gpu.state.depth_test_set("NONE")
    gpu.state.blend_set("NONE")


def draw_band(left: float, right: float, height: float, shade: tuple[float, float, float]) -> None:
    """Draw a filled rectangle on the lower edge of the region being drawn."""
    import gpu  # pyright: ignore[reportMissingImports]
    from gpu_extras.batch import batch_for_shader  # pyright: ignore[reportMissingImports]

    shader = gpu.shader.from_builtin("UNIFORM_COLOR")
    corners = [(left, 0.0), (right, 0.0), (right, height), (left, height)]
    batch = batch_for_shader(shader, "TRIS", {"pos": corners}, indices=[(0, 1, 2), (0, 2, 3)])
    shader.uniform_float("color", (*shade, 1.0))
    batch.draw(shader)
