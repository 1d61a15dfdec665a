"""Convert a trained network to the shipped weight file, measure that file, and write its model card."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.outputs import write_text
from solver_backend.exchange.progress import Progress
from solver_backend.priors.weights import PriorWeights, write_weights
from training.data.corpus import Corpus
from training.engine.loop import TrainingSettings

_SOURCES = """## Data and licence

| source | side | clips | frames at 30 Hz | distinct |
|---|---|---|---|---|
{table}

- **CMU motion capture** (mocap.cs.cmu.edu, sources `asfamc`, `amc`, `mb2`, `expmap`, `max`, `daz`, `segments`,
  `makehuman` from MakeHuman's CC0 files, `daz_more`, `jump` and, for evaluation only, `far` from repositories
  under the MIT licence: Atelier Circle 2018, arpspoof 2021, the authors of acRNN 2018). "The data used in this project
  was obtained from mocap.cs.cmu.edu. The database was created with funding from NSF EIA-0196217." It may be copied,
  modified and redistributed, but not resold directly.
- **UI-PRMD** (`ui_prmd`, Vakanski et al. 2018): rehabilitation movements of eight people with optical markers, fitted
  here with one shape and one set of marker offsets per person. Open Data Commons PDDL 1.0.
- **Hand-keyed animations** (`keyed`) by Quaternius and Mesh2Motion (CC0): rolling, sitting, kneeling, crouching,
  swimming, falling. Each distinct pose counts {keyed_repeats} times. The skeleton of `jump` has no hands and no
  toes, so only one in {simplified_every} of its distinct poses counts.
- **Validation**: subjects {held_out}, which training does not use. Conversions without the subject's number are
  training data unless their frames repeat validation frames, so they may contain other takes of these subjects.

The root mean square distance of the joints of two distinct poses is at least {near_repeat_mm:.0f} mm. Frames with a
joint more than 30° beyond its anatomical range are tracking errors, and both sets omit them.

Recordings become poses of the 21 body joints as follows. Each bone keeps its rotation since the T-pose. Half of the
hand's twist moves to the elbow. The CMU recordings' collar bones do not move, and of their conversions only
`asfamc`, `amc`, `expmap` and `segments` bend the hands. Collars follow the arms by a fixed rhythm (22 % of the
elevation, 15 % of the forward swing). Markers move collars and hands.
"""
_AUGMENTATION = """
Augmentation mirrors left and right, and exchanges arms, legs (both or one), head and spine between clips and sides.
It varies collars by 5°, wrists by 12°, spine, neck and head by 3°, and the other joints by 1.5°. In 15 % of the
windows it moves two joints to 60 to 100 % of one of their ranges.{more} A pose is used if no arm joint is within 7 cm
of a trunk, head or leg bone, and no moved joint is more than 10° beyond its range.
"""
_METHOD = """Measured with the shipped weights on all distinct validation poses, with 24 joints and the pelvis fixed, on
a skeleton of 1.70 m. `worst5` is the worst 5 % of poses. `between_keys` is frames from SIDER2 of three keys' codes.
"""
_LIKELIHOOD = """Mean log densities of the rotation vectors of all distinct poses.
"""


@dataclass(frozen=True)
class Card:
    """Texts of a model card that differ between priors."""

    title: str  # Name of the prior in the title.
    summary: str  # Short description.
    method: str = ""  # Method of measurement, if it differs from that of the other priors.
    augmented: bool = True  # True if augmented poses were used in training.
    augmentation: str = ""  # Augmentation in addition to that of all other augmented trainings.


def write_model_card(path: Path, card: Card, metadata: dict[str, Any]) -> None:
    """Write a prior's model card as a Markdown file.

    Args:
        path: path of the card.
        card: description of the prior.
        metadata: ``data, command, settings, metrics, sha256``, and optionally ``by_source``.
    """
    method = card.method or (_METHOD if "mpjpe_mm" in metadata["metrics"] else _LIKELIHOOD)
    augmentation = _AUGMENTATION.format(more=card.augmentation) if card.augmented else ""
    metrics = "\n".join(f"| `{key}` | {value:.4g} |" for key, value in metadata["metrics"].items())
    settings = "\n".join(f"| `{key}` | {value} |" for key, value in metadata["settings"].items())
    sources = _SOURCES.format(table=_source_table(metadata["data"]["sources"]), **metadata["data"])
    text = (
        f"# {card.title}\n\n{card.summary}\n\n{sources}{augmentation}\n"
        f"## Training\n\n`{metadata['command']}`\n\n| setting | value |\n|---|---|\n{settings}\n\n"
        f"## Validation\n\n{method}\n"
        f"| metric | value |\n|---|---|\n{metrics}\n\n{_accuracy_table(metadata.get('by_source', {}))}"
        f"Arrays' SHA-256: `{metadata['sha256']}`\n"
    )
    write_text(path, text, overwrite=True)


def _source_table(sources: dict[str, dict[str, Any]]) -> str:
    """Return the rows of the data table. Keys have the form "side/source"."""
    rows = []
    for key, counts in sources.items():
        side, source = key.split("/")
        rows.append(f"| {source} | {side} | {counts['clips']} | {counts['frames']} | {counts['distinct']} |")
    return "\n".join(rows)


def _accuracy_table(by_source: dict[str, dict[str, float]]) -> str:
    if not by_source:
        return ""
    head = "| source | poses | MPJPE mm | worst 5 % mm | PCK3 % | angle ° |\n|---|---|---|---|---|---|\n"
    rows = [
        f"| {source} | {f['poses']:.0f} | {f['mpjpe_mm']:.2f} | {f['worst5_mpjpe_mm']:.1f} | {f['pck3_percent']:.1f} "
        f"| {f['angle_deg']:.2f} |\n"
        for source, f in by_source.items()
    ]
    return head + "".join(rows) + "\n"


@dataclass(frozen=True)
class TrainingJob:
    """Data, settings and folders for training one prior."""

    training: Corpus
    validation: Corpus
    settings: TrainingSettings
    out: Path  # Folder for the weights and the model card.
    work: Path  # Folder for the checkpoint and the log.
    command: str  # Command that repeats the training.
    data: dict[str, object]  # Numbers of clips and frames, for the model card.
    progress: Progress
    hidden: int = 512  # Width of SPoser's decoder layers.
    far: Corpus | None = None  # Motions that differ from the corpus, for evaluation, or None if there are none.
    start: Path | None = None  # Weights to start from (for SPoser and the lifter).


@dataclass(frozen=True)
class Finished:
    """Weight file and figures of a trained prior."""

    weights: Path
    metrics: dict[str, float]
    absent: tuple[str, ...] = ()  # Held-out subjects that are missing in the recordings, and therefore in the figures.


Figures = dict[str, Any]  # ``metrics``, which are the card's figures by name, and optionally ``by_source``.


def publish(
    job: TrainingJob,
    prior: str,
    arrays: dict[str, np.ndarray],
    header: dict[str, Any],
    settings: dict[str, Any],
    measure: Callable[[Path], Figures],
    card: Card,
) -> Finished:
    """Write ``<prior>.npz``, measure its weights, and write ``<prior>.md`` next to it.

    Args:
        job: training job.
        prior: name of the prior.
        arrays: contents of the weight file.
        header: further data needed to load the weights.
        settings: training settings to list on the card.
        measure: function that loads the file and returns its figures.
        card: texts to add to the card.
    """
    path = job.out / f"{prior}.npz"
    path.parent.mkdir(parents=True, exist_ok=True)
    metadata: dict[str, Any] = {**header, "command": job.command, "settings": settings, "data": job.data}
    write_weights(path, PriorWeights(prior, arrays, metadata))
    metadata |= measure(path)
    metadata["sha256"] = write_weights(path, PriorWeights(prior, arrays, metadata))
    write_model_card(path.with_suffix(".md"), card, metadata)
    return Finished(path, metadata["metrics"])
