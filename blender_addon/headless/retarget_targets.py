"""``retarget`` with several targets: the same motion or folder of clips onto each, every one in a folder of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypedDict

from .._exchange.errors import MocapError
from .._exchange.progress import Progress
from ..errors import BatchInvalid, TargetUnsuitable
from .exit_codes import exit_code
from .result import CommandResult
from .retarget_request import RetargetRequest


class FailedTarget(TypedDict):
    """A target that was left out."""

    target: str
    code: str
    message: str
    exit_code: int


class TargetsResult(CommandResult):
    """Of ``retarget`` to several targets."""

    targets: dict[str, CommandResult]
    failed: list[FailedTarget]


def run_retarget_targets(
    request: RetargetRequest,
    targets: Sequence[Path],
    one: Callable[[RetargetRequest, Progress], CommandResult],
    progress: Progress,
) -> TargetsResult:
    """Retarget to each target; the files of one lie in a folder beside ``out`` that has the target's name.

    A target that is unsuitable is left out and named; the exit code is that of the worst.

    Args:
        request: what to retarget, to any target.
        targets: files with the rigs.
        one: does it for one target.
        progress: called for each.

    Returns:
        The ``result`` event: outputs, the result of each target, and those that failed.

    Raises:
        BatchInvalid: two targets have one name, or one map file is to be written for several.
        TargetUnsuitable: none of them is suitable.
    """
    names = [target.stem for target in targets]
    if len({name.lower() for name in names}) < len(names):
        hint = "Their results would lie in one folder: rename one of the files."
        raise BatchInvalid(f"Two targets have the same name: {', '.join(names)}.", hint=hint)
    if request.save_map is not None:
        raise BatchInvalid("One map file cannot hold several rigs' maps.", hint="Leave out --save-map.")
    results: dict[str, CommandResult] = {}
    failed: list[FailedTarget] = []
    for done, (name, target) in enumerate(zip(names, targets, strict=True)):
        progress(f"target {name}", done, len(targets))
        out = request.out.parent / name / request.out.name
        try:
            results[name] = one(replace(request, target=target, out=out), progress)
        except MocapError as error:
            failed.append({"target": name, "code": error.code, "message": str(error), "exit_code": exit_code(error)})
    if not results:
        listing = " ".join(f"{entry['target']}: {entry['message']}" for entry in failed)
        raise TargetUnsuitable(
            "The motion could not be transferred to any target.", where=str(request.source), hint=listing
        )
    notes = [f"{name}: {note}" for name, result in results.items() for note in result["notes"]]
    return {
        "event": "result", "outputs": [path for result in results.values() for path in result["outputs"]],
        "targets": results, "failed": failed,
        "notes": [*notes, *(f"{entry['target']} failed: {entry['message']}" for entry in failed)],
        "exit_code": max([*(entry["exit_code"] for entry in failed),
                          *(result.get("exit_code", 0) for result in results.values())]),
    }  # fmt: skip
