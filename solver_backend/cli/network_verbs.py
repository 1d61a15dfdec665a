"""The verb that writes a network for other programs."""

from __future__ import annotations

import argparse
from pathlib import Path

from solver_backend.cli.outcome import Outcome
from solver_backend.cli.verbs import training_missing
from solver_backend.exchange.outputs import check_output
from solver_backend.exchange.progress import Progress


def export_network_arguments(verb: argparse.ArgumentParser) -> None:
    """Add the arguments of export-network."""
    verb.add_argument(
        "trained", type=Path, nargs="?", metavar="FOLDER",
        help="a trained row of the landmark networks (--work of train landmarks); the network that ships if left out",
    )  # fmt: skip
    verb.add_argument("--out", type=Path, required=True, metavar="NETWORK.onnx", help="file to write")


def export_network(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Write a landmark network as ONNX: the row of a training with its decoding, or the network that labels."""
    check_output(args.out, overwrite=bool(args.overwrite))
    try:
        from training.landmarks.onnx_export import export_point_network, export_row, read_trained
    except ModuleNotFoundError as error:
        raise training_missing(error, "torch onnx") from error
    from solver_backend.labelling.outputs import LANDMARKS
    from solver_backend.labelling.point_network import load_network

    if args.trained is None:
        landmarks = LANDMARKS
        export_point_network(load_network(), args.out, overwrite=bool(args.overwrite))
    else:
        model = read_trained(args.trained)
        landmarks = tuple(LANDMARKS[column] for column in model.columns)
        export_row(model, args.out, overwrite=bool(args.overwrite))
    progress("Writing the network", 1, 1)
    text = f"{args.out}\n  landmarks   {len(landmarks)}: {', '.join(landmarks)}"
    return Outcome(text, {"network": str(args.out), "landmarks": list(landmarks)})
