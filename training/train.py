"""Train a prior, from recordings to the shipped weight file and model card."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import JobInvalid
from solver_backend.exchange.progress import Progress, silent
from solver_backend.priors.weights import read_weights
from training.data.corpus import (
    HELD_OUT,
    KEYED_REPEATS,
    NEAR_REPEAT_M,
    SIMPLIFIED_EVERY,
    Corpus,
    absent_subjects,
    build_corpus,
    split_corpus,
)
from training.data.sources.clips import load_clips, load_far_clips
from training.engine.loop import TrainingSettings, check_device
from training.engine.publish import Finished, TrainingJob
from training.gmm.train import train_gmm
from training.lifter.train import train_lifter
from training.pose_ndf.network import PoseNdfSettings
from training.pose_ndf.train import train_pose_ndf
from training.sposer.train import train_sposer
from training.vae.train import LATENTS, train_vae
from training.view_lifter.limb_slants import train_limb_slants
from training.view_lifter.task import train_view_lifter

RECIPES: dict[str, Callable[[TrainingJob], Finished]] = {
    "gmm": train_gmm,
    "sposer": train_sposer,
    "pose_ndf": train_pose_ndf,
    "pose_ndf_von_mises": partial(train_pose_ndf, settings=PoseNdfSettings(noise="von Mises")),
    **{kind: partial(train_vae, kind) for kind in LATENTS},
    "lifter": train_lifter,
    "view_lifter": train_view_lifter,
    "limb_slants": train_limb_slants,
}
"""Training function of each prior, by name."""
STARTED = ("sposer", "lifter", "view_lifter")  # Priors whose training can start from earlier weights.
MORE_HELD_OUT: dict[str, frozenset[str]] = {name: frozenset({"49", "135"}) for name in ("view_lifter", "limb_slants")}
"""Further subjects that these trainings exclude: 49 (dance and cartwheels) and 135 (martial arts)."""


def train(
    prior: str,
    data_dir: Path | str,
    out: Path | str,
    *,
    seed: int = 0,
    settings: TrainingSettings | None = None,
    hidden: int = 512,
    start: Path | str | None = None,
    work: Path | str | None = None,
    progress: Progress = silent,
) -> Finished:
    """Train a prior, or resume from its last checkpoint, and write ``<prior>.npz`` and ``<prior>.md``.

    Args:
        prior: one of ``RECIPES``.
        data_dir: folder that contains ``motion_cmu``.
        out: folder of the weights and the model card.
        seed: seed of the initial weights and all draws.
        settings: steps, batch size and so on. Each prior has its own defaults.
        hidden: width of SPoser's decoder layers.
        start: weights to start from (same prior, same widths), or None for random weights.
        work: folder of the checkpoint and the log, by default ``<out>/<prior>_run``.
        progress: called as stages advance.

    Raises:
        JobInvalid: the prior or device is unknown, or the prior does not support a start or a part.
        BackendMissing: the device is unavailable.
        FileMissing: there are no recordings, or none of the held-out subjects.
        TrainingMismatch: the checkpoint has other settings, or the weights have other widths.
        WeightsInvalid: the weights to start from belong to another prior.
    """
    if prior not in RECIPES:
        raise JobInvalid(f"There is no prior {prior!r} (known: {', '.join(sorted(RECIPES))}).")
    settings = settings or TrainingSettings()
    if prior not in STARTED and start is not None:
        raise JobInvalid(f"Only {' and '.join(STARTED)} can start from weights (--from).")
    if prior != "sposer" and settings.part:
        raise JobInvalid("Only sposer can train a part of itself (--part).")
    if settings.part and start is None:
        raise JobInvalid("Training a part needs existing weights.", hint="Add --from WEIGHTS.")
    out, start = Path(out), None if start is None else Path(start)
    chosen = replace(settings, seed=seed, start=read_weights(start, prior).sha256 if start else "")
    check_device(chosen.device)
    held_out = HELD_OUT | MORE_HELD_OUT.get(prior, frozenset())
    clips = load_clips(Path(data_dir), progress, cache=out / "fitted_takes")
    training, validation = split_corpus(clips, held_out)
    far = load_far_clips(Path(data_dir))
    command = _command(prior, chosen) + (f" --hidden {hidden}" if prior == "sposer" else "")
    job = TrainingJob(
        training, validation, chosen, out, Path(work) if work else out / f"{prior}_run", command,
        _describe(training, validation, held_out), progress, hidden, build_corpus(far) if far else None, start,
    )  # fmt: skip
    return replace(RECIPES[prior](job), absent=absent_subjects(clips, held_out))


def _command(prior: str, settings: TrainingSettings) -> str:
    """Return the command that repeats a training, including all options that differ from their defaults."""
    defaults, command = TrainingSettings(), f"manifold train model {prior} --data DIR --seed {settings.seed}"
    command += f" --steps {settings.steps}"
    for name in ("batch", "learning_rate", "part", "device"):
        value = getattr(settings, name)
        command += f" --{name.replace('_', '-')} {value}" if value != getattr(defaults, name) else ""
    return command + (" --from WEIGHTS" if settings.start else "")


def _describe(training: Corpus, validation: Corpus, held_out: frozenset[str]) -> dict[str, object]:
    sources = {}
    for side, corpus in (("training", training), ("validation", validation)):
        of_frame, distinct = corpus.sources, np.unique(corpus.distinct)
        for source in sorted(set(of_frame.tolist())):
            sources[f"{side}/{source}"] = {
                "clips": len({name for name in corpus.names if name.startswith(f"{source}/")}),
                "frames": int((of_frame == source).sum()),
                "distinct": int((of_frame[distinct] == source).sum()),
            }
    return {
        "held_out": ", ".join(sorted(held_out)),
        "near_repeat_mm": 1000 * NEAR_REPEAT_M,
        "keyed_repeats": KEYED_REPEATS,
        "simplified_every": SIMPLIFIED_EVERY,
        "sources": sources,
    }
