"""SPoser from corpus to shipped weights."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import cast

import numpy as np

from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS
from solver_backend.geometry.interpolation import sider2
from solver_backend.priors.sposer import LATENT_DIM, SPoser, load_sposer
from solver_backend.priors.weights import read_stack, read_weights
from training.data.corpus import Corpus
from training.data.recombination import LIMB_SPREAD
from training.data.sources.clips import FPS
from training.engine.accuracy import (
    accuracy_by_source,
    autoencoder_arrays,
    joint_distances,
    reconstruction_accuracy,
)
from training.engine.dense_layers import take_over
from training.engine.loop import run_training
from training.engine.model_card import Card
from training.engine.publish import Figures, publish
from training.engine.recipe import Finished, TrainingJob
from training.sposer.network import SphericalAutoencoder
from training.sposer.task import EncoderTask, SPoserSettings, SPoserTask

_ENCODER_ALONE = (
    """ The encoder was trained alone for the decoder of `--from`, whose weights it ships with as they were."""
)
CARD = Card(
    "SPoser",
    """SPoser (thesis 6.2.2): an autoencoder of the 21 body joints' rotations whose codes are unit vectors of zero
mean in R^32. It is trained to reproduce poses (6.3, 6.4; points are joints and axis tips of every joint's frame), and
to reproduce the frame between keys up to 0.3 s apart from SIDER2 of the keys' codes, as the solver interpolates.""",
)


def train_sposer(job: TrainingJob, settings: SPoserSettings | None = None) -> Finished:
    """Train, export, measure the exported weights and write the model card."""
    settings = settings or SPoserSettings(decoder_hidden=(job.hidden, job.hidden))
    kind = EncoderTask if job.settings.part == "encoder" else SPoserTask
    task = kind(job.training, job.validation, settings, job.settings.batch, job.settings.seed, job.far)
    if job.start is not None:
        start, pose = read_weights(job.start, "sposer"), 6 * NUM_BODY_JOINTS
        take_over(task.model.encoder, read_stack(start, "encoder", pose, LATENT_DIM))
        take_over(task.model.decoder, read_stack(start, "decoder", LATENT_DIM, pose))
    model = cast(SphericalAutoencoder, run_training(task, job.settings, job.work, job.progress))
    truth = job.validation.rotations[job.validation.distinct].astype(np.float64)
    arrays = autoencoder_arrays(model, model.encoder, model.decoder, truth)
    header = {name: getattr(settings, name) for name in ("encoder_hidden", "decoder_hidden", "activation")}
    asked = asdict(settings) | asdict(job.settings)

    def measured(path: Path) -> Figures:
        prior = load_sposer(path)
        unseen = [corpus for corpus in (job.validation, job.far) if corpus is not None]
        by_source = {k: v for corpus in unseen for k, v in accuracy_by_source(corpus, prior.reconstruct).items()}
        return {"metrics": measure(prior, truth, job.validation), "by_source": by_source}

    return publish(job, "sposer", arrays, header, asked, measured, _card(settings, job.settings.part))


def _card(settings: SPoserSettings, part: str) -> Card:
    """Return the card of a training."""
    more = (
        f" In {100 * settings.turned_chance:.0f} % limbs, spine or head turned as a whole by a normal draw of "
        f"{100 * LIMB_SPREAD[0]:.0f} to {100 * LIMB_SPREAD[1]:.0f} % of each joint's\nranges, within its limits; in "
        f"{100 * settings.end_chance:.0f} % ankles, toes and wrists moved anywhere up to one of their ends."
    )
    return replace(CARD, summary=CARD.summary + _ENCODER_ALONE * (part == "encoder"), augmentation=more)


def measure(prior: SPoser, truth: np.ndarray, validation: Corpus) -> dict[str, float]:
    """Return reconstruction figures, and the error of frames between keys at 0.1, 0.2 and 0.3 s."""
    figures = reconstruction_accuracy(truth, prior.reconstruct(truth)).as_dict()
    for spacing in (3, 6, 9):
        error = between_error_mm(prior, validation, spacing)
        figures[f"between_keys_{spacing / FPS:.1f}s_mpjpe_mm"] = error
    return figures


def between_error_mm(prior: SPoser, corpus: Corpus, spacing: int, most: int = 4000) -> float:
    """Return the mean joint error of frames halfway between keys, from SIDER2 of three keys' codes.

    Args:
        prior: what encodes the keys and decodes the frame.
        corpus: motions.
        spacing: frames between neighbouring keys.
        most: windows looked at.
    """
    middle = np.arange(corpus.num_frames)
    fits = (middle - spacing >= corpus.clip_start) & (middle + spacing < corpus.clip_end)
    middle = middle[fits][:: max(1, int(fits.sum()) // most)]
    early = spacing // 2
    a, b, c = (prior.encode(corpus.rotations[middle + k].astype(np.float64)) for k in (-spacing, 0, spacing))
    decoded = prior.decode(sider2(a, b, c, 0.5 * (spacing - early) / spacing))
    truth = corpus.rotations[middle - early].astype(np.float64)
    return 1000 * float(joint_distances(truth, decoded).mean())
