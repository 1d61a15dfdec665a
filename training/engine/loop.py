"""Training loop for all priors: AdamW, cosine schedule, averaged weights, and checkpoints that resume exactly."""

from __future__ import annotations

import copy
import json
import logging
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from torch import nn
from torch.utils.data import DataLoader, Dataset

from solver_backend.exchange.errors import BackendMissing, FileDamaged, JobInvalid, NonFiniteData, TrainingMismatch
from solver_backend.exchange.outputs import atomic_output, write_text
from solver_backend.exchange.progress import Progress, silent

Draw = Callable[[torch.Generator], Any]  # Draws one batch, on the CPU.
_AHEAD = 4  # Number of batches that each process prepares in advance.


def step_generator(seed: int, step: int, purpose: int = 0) -> torch.Generator:
    """Return the CPU generator for a step's batch (purpose 0) or for the noise in its loss (purpose 1)."""
    words = np.random.SeedSequence((seed, step, purpose)).generate_state(2)
    return torch.Generator().manual_seed(int(words[0]) << 31 ^ int(words[1]))


def batches(draw: Draw, seed: int, first: int, last: int, workers: int) -> Iterator[Any]:
    """Yield the batches of steps ``first`` to ``last - 1``, drawn in this process or in advance by ``workers``."""
    if not workers:
        return (draw(step_generator(seed, step)) for step in range(first, last))
    ahead = DataLoader(
        _Steps(draw, seed, first, last),
        batch_size=None,
        num_workers=workers,
        prefetch_factor=_AHEAD,
        generator=torch.Generator(),
    )
    return iter(ahead)


class _Steps(Dataset[Any]):
    def __init__(self, draw: Draw, seed: int, first: int, last: int) -> None:
        self._draw, self._seed, self._first, self._last = draw, seed, first, last

    def __len__(self) -> int:
        return self._last - self._first

    def __getitem__(self, index: int) -> Any:
        return self._draw(step_generator(self._seed, self._first + index))


DEVICES = ("cpu", "cuda")


def check_device(name: str) -> None:
    """Check that this machine can train on a device.

    Raises:
        JobInvalid: the device name is unknown.
        BackendMissing: torch finds no CUDA device.
    """
    if name not in DEVICES:
        raise JobInvalid(f"There is no device {name!r} (known: {', '.join(DEVICES)}).", where="device")
    if name == "cuda" and not torch.cuda.is_available():
        raise BackendMissing(
            "Training on cuda is requested, but torch finds no CUDA device.",
            where="device",
            hint="Train with --device cpu, or install a driver and a torch build for CUDA.",
        )


def device_of(model: nn.Module) -> torch.device:
    """Return the device that stores a network's parameters."""
    return next(model.parameters()).device


def dropout_state(device: str) -> torch.Tensor:
    """Return the state of the random generator for dropout on a device."""
    return torch.get_rng_state() if device == "cpu" else torch.cuda.get_rng_state()


def set_dropout_state(device: str, state: torch.Tensor) -> None:
    """Restore the state of the random generator for dropout on a device."""
    if device == "cpu":
        torch.set_rng_state(state)
    else:
        torch.cuda.set_rng_state(state)


logger = logging.getLogger(__name__)


class EventLog:
    """A folder's validation figures (``log.jsonl``) and TensorBoard events, written during the training."""

    def __init__(self, folder: Path, step: int) -> None:
        """Continue the logs after ``step``. Later lines are removed, so that no step appears twice."""
        self._path = folder / "log.jsonl"
        if self._path.is_file():
            lines = self._path.read_text(encoding="utf-8").splitlines(keepends=True)
            kept = [line for line in lines if line.endswith("\n") and json.loads(line)["step"] <= step]
            write_text(self._path, "".join(kept), overwrite=True)
        self._events = _summary_writer(folder, step)

    def figures(self, step: int, figures: dict[str, float]) -> None:
        """Append the validation figures of a step to ``log.jsonl`` and to TensorBoard's events."""
        with self._path.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps({"step": step, **figures}) + "\n")
        self.scalars(step, {f"validation/{name}": value for name, value in figures.items() if name != "loss"})

    def scalars(self, step: int, scalars: dict[str, float]) -> None:
        """Add a point to each TensorBoard curve."""
        for name, value in scalars.items():
            if self._events is not None:
                self._events.add_scalar(name, value, step)

    def close(self) -> None:
        """Write buffered events, and close the TensorBoard file."""
        if self._events is not None:
            self._events.close()


def _summary_writer(folder: Path, step: int) -> Any:
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        logger.info("TensorBoard is not installed. The curves are only in log.jsonl.")
        return None
    return SummaryWriter(str(folder / "events"), purge_step=step + 1)


_CURVE_EVERY = 20  # Steps between two points of the loss curve.
_FREE = ("checkpoint_s", "workers")  # Settings that do not affect weights, so that a run may be resumed with others.


@dataclass(frozen=True)
class TrainingSettings:
    """Settings of a training run, such as duration and learning rate."""

    steps: int = 6000  # Total number of gradient steps.
    batch: int = 256  # Number of windows per step.
    learning_rate: float = 2e-3  # Largest learning rate, reached after the warm-up.
    weight_decay: float = 1e-4  # Weight decay of AdamW.
    averaging: float = 0.998  # Decay of the exponential moving average of the weights. This average is the result.
    seed: int = 0  # Seed of the initial weights and of all random draws.
    checkpoint_s: float = 60.0  # Seconds between checkpoints.
    evaluate_every: int = 500  # Steps between validations.
    start: str = ""  # SHA-256 of the initial weights, or "" for random ones.
    part: str = ""  # Part of the network to train (SPoser's ``encoder``), or "" for all of it.
    device: str = "cpu"
    """``cpu`` or ``cuda``. Both draw on the CPU with equal results, except dropout and the view lifter's windows."""
    workers: int = 0
    """Processes that prepare batches, or 0 for none. Batches do not depend on it."""


class Task(Protocol):
    """Interface of a training task: a model, its batches, its loss and its validation."""

    @property
    def model(self) -> nn.Module:
        """The network with the parameters to train."""
        ...

    def draw(self, generator: torch.Generator) -> Any:
        """Return a new batch. If batches are drawn on the CPU, worker processes call this method too."""
        ...

    def loss(self, batch: Any, generator: torch.Generator) -> torch.Tensor:
        """Return the loss of a batch on the model's device. The generator is for noise inside the network."""
        ...

    def evaluate(self, model: nn.Module) -> dict[str, float]:
        """Return the validation figures of a model on the CPU."""
        ...


def run_training(task: Task, settings: TrainingSettings, folder: Path, progress: Progress = silent) -> nn.Module:
    """Train, or resume from the last checkpoint in ``folder``. Return the averaged model on the CPU.

    Raises:
        JobInvalid, BackendMissing: the device is unknown or unavailable.
        TrainingMismatch: the checkpoint has other settings or another network.
        FileDamaged: the checkpoint is damaged.
        NonFiniteData: the loss is not finite. The checkpoint is from an earlier step.
    """
    check_device(settings.device)
    folder.mkdir(parents=True, exist_ok=True)
    run = _TrainingRun(task, settings, folder)
    run.resume()
    log = EventLog(folder, run.step)
    for batch in batches(task.draw, settings.seed, run.step, settings.steps, settings.workers):
        run.advance(batch)
        due = run.step == settings.steps or time.monotonic() - run.saved_at > settings.checkpoint_s
        if due or run.step % _CURVE_EVERY == 0:
            run.check()
        if run.step % _CURVE_EVERY == 0:
            log.scalars(run.step, {"training/loss": run.recent, "training/learning_rate": run.learning_rate})
        if run.step % settings.evaluate_every == 0 or run.step == settings.steps:
            log.figures(run.step, {"loss": run.recent, **task.evaluate(run.kept)})
        if due:
            run.save()
        progress("Training", run.step, settings.steps)
    log.close()
    return run.kept


class _TrainingRun:
    def __init__(self, task: Task, settings: TrainingSettings, folder: Path) -> None:
        self.task, self.settings, self.folder, self.step = task, settings, folder, 0
        task.model.to(settings.device)
        self.optimizer = torch.optim.AdamW(
            task.model.parameters(),
            lr=settings.learning_rate,
            weight_decay=settings.weight_decay,
            fused=settings.device == "cuda",
        )
        self.averaged = copy.deepcopy(task.model).requires_grad_(False)
        self.saved_at = time.monotonic()
        self.smoothed = torch.zeros((), device=settings.device)

    @property
    def recent(self) -> float:
        """The loss, averaged over about fifty steps."""
        return float(self.smoothed)

    @property
    def checkpoint(self) -> Path:
        return self.folder / "checkpoint.pt"

    @property
    def learning_rate(self) -> float:
        return self.settings.learning_rate * _schedule(self.step, self.settings.steps)

    @property
    def kept(self) -> nn.Module:
        """The averaged model on the CPU."""
        return self.averaged if self.settings.device == "cpu" else copy.deepcopy(self.averaged).cpu()

    def advance(self, batch: Any) -> None:
        for group in self.optimizer.param_groups:
            group["lr"] = self.learning_rate
        loss = self.task.loss(batch, step_generator(self.settings.seed, self.step, 1))
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(self.task.model.parameters(), 1.0)
        self.optimizer.step()
        self.step += 1
        decay = min(self.settings.averaging, (1 + self.step) / (10 + self.step))
        with torch.no_grad():
            average = torch.optim.swa_utils.get_ema_multi_avg_fn(decay)
            average(list(self.averaged.parameters()), list(self.task.model.parameters()), self.step)
            for kept, fresh in zip(self.averaged.buffers(), self.task.model.buffers(), strict=True):
                kept.copy_(fresh)
            self.smoothed.lerp_(loss, 0.02 if self.step > 1 else 1.0)

    def check(self) -> None:
        """Check that the loss is finite.

        Raises:
            NonFiniteData: the loss is NaN or infinite.
        """
        if not math.isfinite(self.recent):
            raise NonFiniteData(
                f"The loss is not a number at step {self.step}.",
                where=self.checkpoint.name,
                hint="Train into another folder with a lower learning rate. The checkpoint is from before.",
            )

    def save(self) -> None:
        state = {
            "settings": asdict(self.settings),
            "step": self.step,
            "model": self.task.model.state_dict(),
            "averaged": self.averaged.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "global_generator": dropout_state(self.settings.device),
            "recent": self.recent,
        }
        with atomic_output(self.checkpoint, overwrite=True) as temporary:
            torch.save(state, temporary)
        self.saved_at = time.monotonic()

    def resume(self) -> None:
        if not self.checkpoint.is_file():
            return
        try:
            state = torch.load(self.checkpoint, map_location="cpu", weights_only=True)
        except Exception as error:
            raise FileDamaged(
                "The checkpoint cannot be read.", where=self.checkpoint.name, hint="Train into another folder."
            ) from error
        asked, made = asdict(self.settings), state["settings"]
        changed = [name for name, value in asked.items() if name not in _FREE and made.get(name) != value]
        if changed:
            raise TrainingMismatch(
                f"The checkpoint was made with other {', '.join(changed)}.",
                where=self.checkpoint.name,
                hint="Continue with the same settings, or train into another folder.",
            )
        try:
            self.task.model.load_state_dict(state["model"])
        except RuntimeError as error:
            raise TrainingMismatch(
                "The checkpoint contains another network.",
                where=self.checkpoint.name,
                hint="Continue with the same prior and widths, or train into another folder.",
            ) from error
        self.averaged.load_state_dict(state["averaged"])
        self.optimizer.load_state_dict(state["optimizer"])
        set_dropout_state(self.settings.device, state["global_generator"])
        self.step = state["step"]
        self.smoothed.fill_(state["recent"])


def _schedule(step: int, steps: int) -> float:
    """Return the learning rate's factor: a linear warm-up over 2 % of the steps, then a cosine down to 1 %."""
    warm = max(1, steps // 50)
    if step < warm:
        return (step + 1) / warm
    return 0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * (step - warm) / max(1, steps - warm)))
