"""Errors of the shipped view lifter on seen and unseen motion: ``python -m tests.benchmarks.lifter_windows``.

Each row is a set of CMU recordings, filmed with the cameras and faults of the lifter's training, and with exact
detections. Figures are the mean distance of the joints relative to their centre in mm, and after the best similarity.
All are simulated. The fitted marker takes of the corpus are omitted, because fitting takes minutes.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from unittest.mock import patch

import torch

from solver_backend.body.body import load_body
from solver_backend.priors.sposer import load_sposer
from solver_backend.priors.view_lifter import DEFAULT_WEIGHTS
from solver_backend.priors.weights import read_weights
from tests.support.recordings import recordings_folder
from training.data.corpus import HELD_OUT, Corpus, build_corpus, split_corpus
from training.data.sources.clips import KEYED, Clip, load_clips, load_far_clips
from training.train import MORE_HELD_OUT
from training.view_lifter import filming
from training.view_lifter.task import NAME, ViewLifterSettings, ViewLifterTask

UNSEEN = HELD_OUT | MORE_HELD_OUT[NAME]
SUBJECTS = {
    "03": "walk", "08": "walk", "13": "exercises", "60_61": "salsa", "135": "martial arts", "49": "dance, cartwheels",
}  # fmt: skip
"""Main motion of the unseen subjects."""
SEEN = ("walking", "running", "basketball", "soccer", "jumping")  # Words in the names of training clips.


def figures(corpus: Corpus, start: Corpus) -> dict[str, float]:
    """Return the lifter's errors on windows of a corpus. ``start`` is any corpus, which is not used."""
    settings = ViewLifterSettings(exchanged=0)
    task = ViewLifterTask(start, corpus, load_body(), load_sposer(), settings, batch=1, seed=0)
    arrays = read_weights(DEFAULT_WEIGHTS, NAME).arrays
    task.model.load_state_dict({name: torch.as_tensor(array).float() for name, array in arrays.items()})
    return task.evaluate(task.model)


def exact(
    image: torch.Tensor, depth: torch.Tensor, distance: torch.Tensor, inside: torch.Tensor, generator: torch.Generator
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return exact detections of all points, in place of the simulated detector's."""
    return image, inside[..., None].expand(image.shape[:3]).float()


def main() -> None:
    """Print a row for each set."""
    clips = load_clips(recordings_folder(), fitted=False)
    seen, unseen = ([clip for clip in clips if (clip.subject in UNSEEN) is side] for side in (False, True))
    start, (training, validation) = build_corpus(seen[:1]), split_corpus(clips, UNSEEN)

    def some(chosen: list[Clip], of: Callable[[Clip], bool]) -> Corpus:
        return build_corpus([clip for clip in chosen if of(clip)])

    rows = {"training": training, "validation": validation}
    rows |= {f"unseen {who}: {what}": some(unseen, lambda c, w=who: c.subject == w) for who, what in SUBJECTS.items()}
    rows |= {"unseen class: Indian dances": build_corpus(load_far_clips(recordings_folder()))}
    rows |= {f"seen {word}": some(seen, lambda c, w=word: w in c.name) for word in SEEN}
    rows |= {"seen falls, rolls, kneeling": some(seen, lambda c: c.subject == KEYED)}
    for name, corpus in rows.items():
        faulty = figures(corpus, start)
        with patch.object(filming, "_detected", exact):
            clean = figures(corpus, start)
        values = [found[key] for key in ("joints_mm", "pa_joints_mm") for found in (faulty, clean)]
        sys.stdout.write(
            f"{name:30} with faults {values[0]:.1f} (pa {values[2]:.1f}), exact {values[1]:.1f} (pa {values[3]:.1f})\n"
        )
        sys.stdout.flush()


if __name__ == "__main__":
    main()
