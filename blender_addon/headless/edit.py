"""``edit``: write a copy of a take, with fewer keys or with locked feet, as an action."""

from __future__ import annotations

from argparse import Namespace

from .._exchange.outputs import atomic_outputs
from .._exchange.progress import Progress
from ..animation.curves import current_action, is_take
from ..body.controls.limbs import limb_of
from ..errors import NothingToExport
from ..retarget.locked_feet import lock_feet
from ..scene.bake import thinned_take
from ..scene.limb_modes import switch_limbs
from ..scene.session import request_of, write_blocks
from .export import open_body
from .result import CommandResult


def run_edit(args: Namespace, progress: Progress) -> CommandResult:
    """Write an edited copy of the current take. Foot locking writes no copy if no foot is planted."""
    scene, armature = open_body(args)
    take, request = current_action(armature), request_of(scene)
    if take is None or not is_take(take):
        hint = "Solve or import a motion first."
        raise NothingToExport("The armature does not show a take.", where=armature.name, hint=hint)
    for key, path in request.get("files", {}).items():
        take[key] = path
    about: CommandResult = {}
    if switch := request.get("switch"):
        to, *limbs = switch
        action, about = take, {"frames": switch_limbs(armature, scene, to, [limb_of(name) for name in limbs], progress)}
    elif args.lock_feet:
        progress("Locking feet", 0, 1)
        locked = lock_feet(scene, take, armature, args.lock_feet)
        action = None if locked is None else locked.action
        about = {} if locked is None else {"stands": locked.stands, "slid_mm": locked.slid_mm}
    else:
        action = thinned_take(scene, take, armature, args.keys_per_second, args.keys_within, progress)
    if action is not None:
        with atomic_outputs(args.out.parent, (args.out.name,), overwrite=args.overwrite) as temporary:
            write_blocks(temporary[args.out.name], {action}, fake_user=True)
    return {"outputs": [str(args.out)], "notes": [], "action": "" if action is None else action.name, **about}
