"""Training a prior from recordings to the weight file and model card that ship."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from solver_backend.errors import JobInvalid, MocapError
from solver_backend.progress import ConsoleProgress, Progress, silent
from solver_backend.training.corpus import (
    HELD_OUT,
    KEYED,
    KEYED_REPEATS,
    NEAR_REPEAT_M,
    Corpus,
    load_clips,
    split_corpus,
)
from solver_backend.training.loop import TrainingSettings
from solver_backend.training.recipe import Finished, Job
from solver_backend.training.train_gmm import train_gmm
from solver_backend.training.train_pose_ndf import train_pose_ndf
from solver_backend.training.train_sposer import train_sposer
from solver_backend.training.train_vae import train_rvposer, train_vposer

RECIPES: dict[str, Callable[[Job], Finished]] = {
    "gmm": train_gmm,
    "sposer": train_sposer,
    "rvposer": train_rvposer,
    "vposer": train_vposer,
    "pose_ndf": train_pose_ndf,
}
"""What trains each prior."""


def train(
    prior: str,
    data_dir: Path | str,
    out: Path | str,
    *,
    seed: int = 0,
    settings: TrainingSettings | None = None,
    work: Path | str | None = None,
    progress: Progress = silent,
) -> Finished:
    """Train a prior, or go on from its last checkpoint, and write ``<prior>.npz`` and ``<prior>.md``.

    Args:
        prior: one of ``RECIPES``.
        data_dir: folder that holds ``motion_cmu``.
        out: folder of the weights and the model card.
        seed: of the initial weights and every draw.
        settings: steps, batch and the like; each prior has defaults of its own.
        work: folder of the checkpoint and the log; ``<out>/<prior>_run`` if None.
        progress: called as stages advance.

    Raises:
        JobInvalid: unknown prior.
        FileMissing: no recordings.
        TrainingMismatch: the checkpoint there was made with other settings.
    """
    if prior not in RECIPES:
        raise JobInvalid(f"There is no prior {prior!r} (known: {', '.join(sorted(RECIPES))}).")
    out = Path(out)
    chosen = replace(settings or TrainingSettings(), seed=seed)
    training, validation = split_corpus(load_clips(Path(data_dir), progress))
    command = f"python -m solver_backend.training.train {prior} --data DIR --seed {seed} --steps {chosen.steps}"
    job = Job(
        training, validation, chosen, out, Path(work) if work else out / f"{prior}_run", command,
        _describe(training, validation), progress,
    )  # fmt: skip
    return RECIPES[prior](job)


def _describe(training: Corpus, validation: Corpus) -> dict[str, object]:
    figures: dict[str, object] = {"held_out": ", ".join(sorted(HELD_OUT)), "near_repeat_mm": 1000 * NEAR_REPEAT_M}
    figures |= {"keyed_clips": sum(n.startswith(f"{KEYED}/") for n in training.names), "keyed_repeats": KEYED_REPEATS}
    for side, corpus in (("train", training), ("validation", validation)):
        figures |= {
            f"{side}_clips": len(corpus.names),
            f"{side}_frames": corpus.num_frames,
            f"{side}_distinct": len(np.unique(corpus.distinct)),
        }
    return figures


def main(arguments: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    defaults = TrainingSettings()
    parser = argparse.ArgumentParser(prog="python -m solver_backend.training.train", description=__doc__)
    parser.add_argument("prior", choices=sorted(RECIPES))
    parser.add_argument("--data", required=True, type=Path, help="folder that holds motion_cmu")
    parser.add_argument("--out", type=Path, default=Path("trained"), help="folder of the weights and the model card")
    parser.add_argument("--work", type=Path, help="folder of the checkpoint and the log")
    for name, value in asdict(defaults).items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=type(value), default=value)
    chosen = parser.parse_args(arguments)
    settings = TrainingSettings(**{name: getattr(chosen, name) for name in asdict(defaults)})
    try:
        finished = train(
            chosen.prior, chosen.data, chosen.out, seed=settings.seed, settings=settings, work=chosen.work,
            progress=ConsoleProgress(),
        )  # fmt: skip
    except MocapError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    sys.stdout.write(f"{finished.weights}\n" + "".join(f"{k}: {v:.4g}\n" for k, v in finished.metrics.items()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
