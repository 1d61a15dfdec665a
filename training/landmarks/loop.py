"""Train a landmark network for a number of steps or seconds. On a GPU, each step is one CUDA graph."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch

from solver_backend.exchange.errors import FileDamaged, FileMissing, NonFiniteData, TrainingMismatch
from solver_backend.exchange.outputs import atomic_output
from training.landmarks.models import LandmarkModel
from training.landmarks.poses import Draw

_WARM_UP = 3  # Steps before a graph is captured. During these, libraries choose their kernels.
_SYNCHRONISED = 10  # Steps between checks of the time.


@dataclass(frozen=True)
class LandmarkTraining:
    """Settings for training a landmark network, such as duration and learning rate."""

    steps: int = 0  # Total number of gradient steps. 0 means that only the time is limited.
    seconds: float = 60.0  # Total time if ``steps`` is 0. The learning rate decreases with the remaining time.
    processor: bool = False
    """Measure processor time of all threads instead of elapsed time. Other load on the machine does not affect it."""
    batch: int = 256
    learning_rate: float = 1e-3
    weight_decay: float = 1e-2
    averaging: float = 0.999  # Decay of the moving average of the weights. This average is the result.
    seed: int = 0
    device: str = "cpu"
    graph: bool = False  # Capture the step as a CUDA graph.
    checkpoint_s: float = 60.0
    judged: int = 3  # Number of evaluations at equal intervals. The best weights are the result.


Evaluate = Callable[[LandmarkModel, float, int], None]  # Called with the averaged model, the seconds and the steps.


def train_landmarks(
    model: LandmarkModel,
    draw: Draw,
    settings: LandmarkTraining,
    folder: Path,
    evaluate: Evaluate,
    start: Path | None = None,
    row: Mapping[str, Any] | None = None,
) -> LandmarkModel:
    """Train a model on a stream of clouds, or resume from the checkpoint in ``folder``. Return the averaged model.

    Args:
        model: untrained model.
        draw: function that makes a batch of clouds, given the completed fraction of the training.
        settings: duration, learning rate and so on.
        folder: folder for the checkpoint.
        evaluate: function that is called a few times with the averaged model.
        start: checkpoint of another row or seed to start from, if ``folder`` has none.
        row: description of the training, including its ``name``. It must equal the one in the checkpoint.

    Raises:
        TrainingMismatch, FileMissing, FileDamaged: the checkpoint belongs to another training, is missing or damaged.
        NonFiniteData: the loss is NaN or infinite. The last checkpoint does not change.
    """
    folder.mkdir(parents=True, exist_ok=True)
    run = _LandmarkRun(model, draw, settings, folder, dict(row or {}))
    if run.checkpoint.is_file():
        run.resume(run.checkpoint)
    elif start:
        run.resume(start, other_row=True)
    run.advance()
    run.started = run.now()
    saved, evaluated = time.monotonic(), math.floor(settings.judged * run.share)
    while not run.finished:
        run.advance()
        if run.steps % _SYNCHRONISED:
            continue
        run.synchronise()
        run.check_loss()
        if math.floor(settings.judged * run.share) > evaluated and not run.finished:
            before, evaluated = run.now(), math.floor(settings.judged * run.share)
            evaluate(run.averaged, run.seconds, run.steps)
            run.paused += run.now() - before
        if time.monotonic() - saved > settings.checkpoint_s:
            run.save()
            saved = time.monotonic()
    run.check_loss()
    run.save()
    evaluate(run.averaged, run.seconds, run.steps)
    return run.averaged


class _LandmarkRun:
    def __init__(
        self, model: LandmarkModel, draw: Draw, settings: LandmarkTraining, folder: Path, row: dict[str, Any]
    ) -> None:
        self.settings, self.draw, self.row = settings, draw, row
        self.checkpoint = folder / "checkpoint.pt"
        self.model = model.to(settings.device)
        self.averaged = copy.deepcopy(model).requires_grad_(False)
        self.steps, self.before_s, self.paused = 0, 0.0, 0.0
        self.now = time.process_time if settings.processor else time.monotonic
        self.started = self.now()
        cuda = settings.device == "cuda"
        self.rate = torch.tensor(0.0, device=settings.device) if cuda else 0.0
        self.optimizer = torch.optim.AdamW(
            self.model.parameters(), lr=self.rate, weight_decay=settings.weight_decay, capturable=cuda, fused=cuda
        )
        self.decay = torch.tensor(0.0, device=settings.device)
        self.done = torch.tensor(0.0, device=settings.device)
        self.loss = torch.tensor(0.0, device=settings.device)
        self.graph: torch.cuda.CUDAGraph | None = None
        self.half = cuda and model.half_precision

    @property
    def seconds(self) -> float:
        """Total training time in seconds, over all runs."""
        return self.before_s + self.now() - self.started - self.paused

    @property
    def share(self) -> float:
        return self.steps / self.settings.steps if self.settings.steps else self.seconds / self.settings.seconds

    @property
    def finished(self) -> bool:
        return self.share >= 1.0

    def advance(self) -> None:
        share = self.share
        rate = self.settings.learning_rate * _schedule(share, self.steps)
        self.done.fill_(share)
        if isinstance(self.rate, torch.Tensor):
            self.rate.fill_(rate)
        else:
            self.optimizer.param_groups[0]["lr"] = rate
        self.decay.fill_(1.0 - min(self.settings.averaging, (1 + self.steps) / (10 + self.steps)))
        if self.settings.graph and self.steps >= _WARM_UP:
            if self.graph is None:
                self.graph = self._captured()
            self.graph.replay()
        else:
            self._step()
        self.steps += 1

    def _step(self) -> None:
        clouds = self.draw(self.done)
        with torch.autocast(self.settings.device, torch.bfloat16, enabled=self.half):
            loss = self.model.loss(clouds)
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.model.parameters(), 1.0, foreach=True)
        self.optimizer.step()
        self.loss.copy_(loss.detach())
        with torch.no_grad():
            for kept, fresh in zip(self.averaged.parameters(), self.model.parameters(), strict=True):
                kept.add_(self.decay * (fresh - kept))
            for a, b in zip(self.averaged.buffers(), self.model.buffers(), strict=True):
                a.copy_(b)

    def _captured(self) -> torch.cuda.CUDAGraph:
        """Return a training step as a CUDA graph, captured after a warm-up on a separate stream."""
        side = torch.cuda.Stream()
        side.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(side):
            for _ in range(_WARM_UP):
                self._step()
        torch.cuda.current_stream().wait_stream(side)
        torch.cuda.synchronize()
        graph = torch.cuda.CUDAGraph()
        self.optimizer.zero_grad(set_to_none=True)
        with torch.cuda.graph(graph):
            self._step()
        return graph

    def synchronise(self) -> None:
        if self.settings.device == "cuda":
            torch.cuda.synchronize()

    def check_loss(self) -> None:
        """Raise ``NonFiniteData`` if the loss is not finite, because it would never become finite again."""
        if not bool(torch.isfinite(self.loss)):
            raise NonFiniteData(
                f"The loss is not a number at step {self.steps}.",
                where=self.checkpoint.name,
                hint="Train into another folder with a lower learning rate. The checkpoint is from before.",
            )

    def save(self) -> None:
        state = {
            "row": self.row,
            "settings": asdict(self.settings),
            "steps": self.steps,
            "seconds": self.seconds,
            "model": self.model.state_dict(),
            "averaged": self.averaged.state_dict(),
            "optimizer": self.optimizer.state_dict(),
        }
        with atomic_output(self.checkpoint, overwrite=True) as temporary:
            torch.save(state, temporary)

    def resume(self, checkpoint: Path, *, other_row: bool = False) -> None:
        """Load a checkpoint, optionally from another row or seed.

        The number of steps or seconds may be larger than in the checkpoint.
        """
        if not checkpoint.is_file():
            raise FileMissing(
                "There is no such checkpoint.",
                where=str(checkpoint),
                hint="Give the checkpoint.pt in the folder of an earlier training.",
            )
        try:
            state = torch.load(checkpoint, map_location=self.settings.device, weights_only=True)
            free = {"steps", "seconds", "checkpoint_s", "graph", "device", "judged", *(["seed"] * other_row)}
            mine = {k: v for k, v in asdict(self.settings).items() if k not in free}
            theirs = asdict(LandmarkTraining()) | state["settings"]
            changed = [key for key, value in mine.items() if theirs[key] != value]
        except Exception as error:
            raise FileDamaged("The checkpoint cannot be read.", where=checkpoint.name) from error
        if changed:
            raise TrainingMismatch(
                f"The checkpoint was made with other {', '.join(changed)}.",
                where=checkpoint.name,
                hint="Continue with the same settings, or train into another folder.",
            )
        if not other_row:
            _same_row(state.get("row"), self.row, checkpoint)
        try:
            self.model.load_state_dict(state["model"])
        except RuntimeError as error:
            raise TrainingMismatch(
                "The checkpoint contains another network.", where=checkpoint.name, hint="Train into another folder."
            ) from error
        self.averaged.load_state_dict(state["averaged"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.optimizer.param_groups[0]["lr"] = self.rate
        self.steps, self.before_s = state["steps"], state["seconds"]
        torch.manual_seed(self.settings.seed + self.steps)
        self.started = self.now()


def _same_row(theirs: Mapping[str, Any] | None, mine: Mapping[str, Any], checkpoint: Path) -> None:
    """Raise ``TrainingMismatch`` if a checkpoint belongs to a different row of the tables."""
    changed = [] if theirs is None else [key for key, value in mine.items() if theirs.get(key, value) != value]
    if theirs is None or not changed:
        return
    name = theirs.get("name", "")
    other = (
        f"not of {mine['name']!r}" if "name" in changed else f"but with other {', '.join(changed)} than asked for now"
    )
    raise TrainingMismatch(
        f"The checkpoint is of row {name!r}, {other}.",
        where=str(checkpoint),
        hint="Give each row its own folder (--work), or continue from another row's checkpoint with --from.",
    )


def _schedule(share: float, steps: int) -> float:
    """Return the learning rate's factor: a warm-up over 200 steps, then a cosine down to 1 %."""
    return min(1.0, (steps + 1) / 200) * (0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * min(share, 1.0))))
