"""Shapes of operators: one undo step, one sentence where something is wrong, what they need first, what is dropped."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy

from ..._exchange.errors import MocapError

if TYPE_CHECKING:
    Operator, FileHandler = bpy.types.Operator, bpy.types.FileHandler
else:
    Operator = FileHandler = object  # Blender's own stands beside a mixin, not above it


class MocapOperator(Operator):
    """Mixin of operators that change the scene in one undo step; ``work`` does what the operator is for.

    Modules that do the work are imported there, not at the top: registering loads no arrays and no solver.
    """

    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender reads a plain set

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Do the work, or report what is wrong."""
        try:
            return self.work(context)
        except MocapError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}

    def work(self, context: bpy.types.Context) -> set[str]:
        """Do what the operator is for and return its answer.

        Raises:
            MocapError: it cannot be done.
        """
        raise NotImplementedError


class NeedsBody(MocapOperator):
    """Mixin of operators on the solved body."""

    edits_body = False
    """Whether the body is changed, which one that is linked from another file does not allow."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs a body."""
        return _there(cls, context.scene.mocap.review.armature)


class NeedsTake(NeedsBody):
    """Mixin of operators on the take the body plays."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs a solved take."""
        review = context.scene.mocap.review
        return _there(cls, review.armature, review.take)


class ViewportDrop(FileHandler):
    """Mixin of what takes files that are dropped on the 3D viewport."""

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        """Only there."""
        return context.area is not None and context.area.type == "VIEW_3D"


def _there(operator: type[NeedsBody], armature: bpy.types.Object | None, *more: bpy.types.ID | None) -> bool:
    if armature is None or None in more:
        operator.poll_message_set("Solve a capture first")
        return False
    if operator.edits_body and not armature.is_editable:
        operator.poll_message_set("This body is linked: choose Object > Library Override > Make first")
        return False
    return True
