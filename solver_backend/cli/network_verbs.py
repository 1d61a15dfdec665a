"""The verb that writes a network for other programs."""

from __future__ import annotations

import argparse

from solver_backend.cli.outcome import Outcome
from solver_backend.cli.verbs import training_missing
from solver_backend.exchange.progress import Progress


def export_network(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Write a landmark network as ONNX: the row of a training with its decoding, or the network that labels."""
    try:
        from training.landmarks.onnx_export import export_point_network, export_row, read_trained
    except ModuleNotFoundError as error:
        raise training_missing(error, "torch onnx") from error
    from solver_backend.labelling.outputs import LANDMARKS
    from solver_backend.labelling.point_network import load_network

    if args.trained is None:
        landmarks = LANDMARKS
        export_point_network(load_network(), args.out, overwrite=args.overwrite)
    else:
        model = read_trained(args.trained)
        landmarks = tuple(LANDMARKS[column] for column in model.columns)
        export_row(model, args.out, overwrite=args.overwrite)
    progress("Writing the network", 1, 1)
    text = f"{args.out}\n  landmarks   {len(landmarks)}: {', '.join(landmarks)}"
    return Outcome(text, {"network": str(args.out), "landmarks": list(landmarks)})
