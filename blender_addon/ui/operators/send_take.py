"""Sending the take while it plays: every frame that the scene goes to, until it is stopped."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy

from ..sending_properties import allowed_address
from .base import MocapOperator

if TYPE_CHECKING:
    from ...scene.take_sender import TakeSender


class CurrentSending:
    """What sends the take of this Blender; there is at most one."""

    def __init__(self) -> None:
        self.sender: TakeSender | None = None
        self.message = ""

    @property
    def busy(self) -> bool:
        """Whether a take is sent while it plays."""
        return self.sender is not None

    def begin(self, sender: TakeSender, message: str) -> None:
        """Send from now on."""
        self.stop()
        self.sender, self.message = sender, message

    def on_frame(self, scene: bpy.types.Scene) -> None:
        """Send the pose of a frame; end where the body is gone."""
        if self.sender is None:
            return
        message = self.sender.send(scene)
        if message is None:
            self.stop()
            self.message = "The body was removed: sending has stopped."
        elif message:
            self.message = message

    def stop(self) -> None:
        """Send no more."""
        if self.sender is not None:
            self.sender.close()
        self.sender, self.message = None, ""


playing = CurrentSending()


@bpy.app.handlers.persistent
def on_frame_change(scene: bpy.types.Scene, *_: object) -> None:
    """Send the pose of the frame that the scene went to."""
    playing.on_frame(scene)


@bpy.app.handlers.persistent
def before_load(*_: object) -> None:
    """Send no more when another file is opened."""
    playing.stop()


class MOCAP_OT_send_take(MocapOperator, bpy.types.Operator):
    """Begins or ends sending the take while it plays."""

    bl_idname = "mocap.send_take"
    bl_label = "Send While Playing"
    bl_description = "Send the body's pose by the VMC protocol at each frame that is shown, with every hand edit"
    bl_options = {"INTERNAL"}  # noqa: RUF012 - Blender reads a plain set

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs a body."""
        if context.scene.mocap.review.armature is None and not playing.busy:
            cls.poll_message_set("Solve or import a motion first")
            return False
        return True

    def work(self, context: bpy.types.Context) -> set[str]:
        """Begin, and send the pose of this frame; or end."""
        from ...scene.take_sender import TakeSender

        if playing.busy:
            playing.stop()
            return {"FINISHED"}
        address = allowed_address(context.scene.mocap.live.send_to)
        playing.begin(TakeSender(context.scene.mocap.review.armature, address), f"Sending to {address} while playing.")
        playing.on_frame(context.scene)
        return {"FINISHED"}


CLASSES = (MOCAP_OT_send_take,)
