"""Run the verbs that train networks and export them to other programs."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from solver_backend.cli.outcome import Outcome, rows
from solver_backend.exchange.errors import BackendMissing
from solver_backend.exchange.progress import Progress

if TYPE_CHECKING:
    from training.engine.publish import Finished


def train(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Train a pose prior or network, and write its weights and model card."""
    try:
        from training.engine.loop import TrainingSettings
        from training.train import train as train_prior
    except ModuleNotFoundError as error:
        raise _missing(error, "torch scipy") from error
    if args.prior == "landmarks":
        return _train_landmarks(args, progress)
    settings = TrainingSettings(**_given(args, "steps", "batch", "learning_rate", "part", "device", "workers"))
    rest = {name: getattr(args, name) for name in ("seed", "hidden", "start", "work")}
    finished = train_prior(args.prior, args.data, args.out, settings=settings, progress=progress, **rest)
    figures = {name: round(value, 4) for name, value in finished.metrics.items()}
    return _trained(finished, [f"  {name:<30} {value:.4g}" for name, value in figures.items()], figures)


def _train_landmarks(args: argparse.Namespace, progress: Progress) -> Outcome:
    from training.landmarks.loop import LandmarkTraining
    from training.landmarks.train import train_landmark_rows

    given = _given(args, "steps", "seconds", "batch", "learning_rate", "device")
    settings = LandmarkTraining(seed=args.seed, graph=args.device == "cuda", processor=args.processor, **given)
    rest = {name: getattr(args, name) for name in ("row", "width", "resolution", "work", "start", "balanced_by")}
    finished = train_landmark_rows(args.data, args.out, settings, progress=progress, **rest)
    return _trained(finished, [], {name: round(value, 4) for name, value in finished.metrics.items()})


def _given(args: argparse.Namespace, *names: str) -> dict[str, Any]:
    return {name: value for name in names if (value := getattr(args, name)) is not None}


def _trained(finished: Finished, lines: list[str], figures: dict[str, float]) -> Outcome:
    """Report the path and figures of trained weights, and the held-out subjects that have no recordings."""
    if finished.absent:
        lines = [f"  held-out subjects not among the recordings: {', '.join(finished.absent)}", *lines]
    data = {"weights": str(finished.weights), "absent_subjects": list(finished.absent), **figures}
    return Outcome("\n".join([str(finished.weights), *lines]), data)


def export_network(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Export the labelling network, or a trained landmark network with its decoding step, to ONNX."""
    try:
        from training.landmarks.onnx_export import export_point_network, export_row, read_trained
    except ModuleNotFoundError as error:
        raise _missing(error, "torch onnx") from error
    from solver_backend.labelling.outputs import LANDMARKS
    from solver_backend.labelling.point_network import load_network

    landmarks = LANDMARKS
    if args.trained is None:
        export_point_network(load_network(), args.out, overwrite=args.overwrite)
    else:
        model = read_trained(args.trained)
        landmarks = tuple(LANDMARKS[column] for column in model.columns)
        export_row(model, args.out, overwrite=args.overwrite)
    progress("Writing the network", 1, 1)
    lines = [str(args.out), *rows("landmarks", f"{len(landmarks)}: {', '.join(landmarks)}")]
    return Outcome("\n".join(lines), {"network": str(args.out), "landmarks": list(landmarks)})


def _missing(error: ModuleNotFoundError, libraries: str) -> BackendMissing:
    """Return the error for a missing library, or for the missing training package."""
    if str(error.name).partition(".")[0] == "training":
        return BackendMissing(
            "The Blender extension does not include training.", hint="Run it in a clone of the repository."
        )
    return BackendMissing(
        f"Training needs the package {error.name}, which is not installed.",
        hint=f"Install the libraries with: pip install {libraries}.",
    )
