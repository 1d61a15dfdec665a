"""Reach of SPoser: held-out subjects, and dances unlike all its training data (validation only).

Figures are joint errors with fixed pelvis on a skeleton of 1.70 m, for distinct poses. Codes are the encoder's initial
codes, SPoser's final codes, and the nearest of all codes on 500 poses, which a solver that moves codes can reach. Ends:
held-out poses with one angle of foot, toes or hand set to the end of its range and decoded, and a take with such
angles, solved from views and from markers. Needs the recordings next to the repository (or MOCAP_SHARED_DATA).
--weights measures another weight file.
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import FileMissing
from solver_backend.priors.sposer import DEFAULT_WEIGHTS, SPoser, load_sposer
from tests.benchmarks.metric import BenchmarkSkipped, Metric
from tests.benchmarks.pose_priors import reach
from tests.benchmarks.pose_priors.joint_ends import held_at_ends
from tests.benchmarks.pose_priors.prior_tables import Table, text_table
from tests.benchmarks.pose_priors.solved_ends import solved_at_ends
from tests.support.recordings import ABSENT, recordings_folder
from training.data.corpus import HELD_OUT, Corpus, build_corpus
from training.data.sources.clips import load_clips, load_far_clips
from training.engine.accuracy import accuracy_by_source

_TAKES = Path(__file__).resolve().parents[2] / "build" / "priors" / "fitted_takes"
_NEAREST = 500
_KEYS = {"mean mm": "mean_mm", "median mm": "median_mm", "worst 5 % mm": "worst5_mm"}


def run(weights: Path = DEFAULT_WEIGHTS) -> list[Metric]:
    """Print the tables and return the figures."""
    prior = load_sposer(weights)
    far, unseen = _read(recordings_folder())
    rows = _errors(prior, "held-out subjects", unseen) | _errors(prior, "far dances", far)
    truth = _distinct(far)
    parts = [
        text_table("Reach of SPoser", rows),
        text_table("Held-out subjects by source", accuracy_by_source(unseen, prior.reconstruct)),
        text_table("Far dances by joint", reach.joint_errors(truth, prior.reconstruct(truth))),
        text_table("Ends of ranges", held_at_ends(prior, unseen.some_distinct(_NEAREST).astype(np.float64))),
        text_table("Ends of ranges, solved", solved_at_ends(prior)),
    ]
    sys.stdout.write("\n".join(parts))
    return [
        Metric(f"{'_'.join(re.findall('[a-z]+', row))}_{_KEYS[column]}", value, "mm")
        for row, figures in rows.items()
        for column, value in figures.items()
    ]


def _read(data: Path) -> tuple[Corpus, Corpus]:
    """Return the far motions and the held-out subjects."""
    far = load_far_clips(data)
    try:
        clips = [clip for clip in load_clips(data, cache=_TAKES) if clip.subject in HELD_OUT]
    except FileMissing as error:
        raise BenchmarkSkipped("The recordings are not here.", hint=ABSENT) from error
    if not far:
        raise BenchmarkSkipped("The far motions are not here.", hint=ABSENT)
    return build_corpus(far), build_corpus(clips)


def _distinct(corpus: Corpus) -> np.ndarray:
    return corpus.rotations[np.unique(corpus.distinct)].astype(np.float64)


def _errors(prior: SPoser, who: str, corpus: Corpus) -> Table:
    truth, some = _distinct(corpus), corpus.some_distinct(_NEAREST).astype(np.float64)
    nearest = prior.decode(reach.nearest_codes(prior, some))
    return {
        f"{who}, encoder's guess": reach.pose_errors(truth, prior.decode(prior.guess(truth))),
        who: reach.pose_errors(truth, prior.reconstruct(truth)),
        f"{who}, nearest code": reach.pose_errors(some, nearest),
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="bench_reach", description="How far SPoser reaches.")
    parser.add_argument("--weights", type=Path, default=DEFAULT_WEIGHTS, help="the weight file that is measured")
    run(parser.parse_args().weights)
