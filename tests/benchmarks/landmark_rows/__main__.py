r"""Write tables 4.1 to 4.6 and a picture of the largest errors for trained rows. Each is a folder given as ``--work``.

    python -m tests.benchmarks.landmark_rows --out OUT [--poses landmark_poses.npz --pictured base "ortho fading"] \
        base=trained/base_1 "ortho fading=trained/fading_1" ...

The first row is the base of all ratios. The program writes ``tables.md`` to OUT. With poses, it also writes
``tail.png`` with the pictured rows and the shipped network.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.exchange.outputs import write_text
from solver_backend.labelling.point_network import load_network
from tests.benchmarks.landmark_rows.row_tables import read_figures, row_tables
from tests.benchmarks.landmark_rows.tail_pictures import (
    SHOWN,
    draw_tail,
    landmarks,
    representative,
)
from training.landmarks.cloud_stream import CloudStream, Variety
from training.landmarks.models import LandmarkModel
from training.landmarks.onnx_export import trained_model
from training.landmarks.poses import GROUPS, PoseTable
from training.landmarks.rows import CLOUDS, evaluation_clouds, evaluation_poses


def main() -> None:
    """Write the tables, and the picture if poses are given."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rows", nargs="+", metavar="NAME=FOLDER")
    parser.add_argument("--out", type=Path, default=Path("build/landmark_rows"))
    parser.add_argument("--kind", choices=(*CLOUDS, "any"), default="fixed", help="clouds that tables are of")
    parser.add_argument("--poses", type=Path, help="table of poses, for the picture")
    parser.add_argument("--pictured", nargs="*", default=[], metavar="NAME")
    args = parser.parse_args()
    folders = {name: Path(folder) for name, _, folder in (row.partition("=") for row in args.rows)}
    missing = [name for name, folder in folders.items() if not (folder / "figures.json").is_file()]
    unknown = [name for name in args.pictured if name not in folders]
    if missing or unknown:
        parser.error(f"No figures.json for {', '.join(missing + unknown)}: give NAME=FOLDER, the folder of --work.")
    figures = read_figures(folders)
    text = row_tables(figures, next(iter(folders)), args.kind)
    args.out.mkdir(parents=True, exist_ok=True)
    write_text(args.out / "tables.md", text + "\n", overwrite=True)
    print(text)
    if args.poses:
        rows = {name: (figures[name], folders[name]) for name in args.pictured or folders}
        models = {name: trained_model(row, folder / "weights.npz") for name, (row, folder) in rows.items()}
        picture(PoseTable.read(args.poses), models, args.out / "tail.png", args.kind)


def picture(table: PoseTable, models: dict[str, LandmarkModel], out: Path, kind: str) -> None:
    """Draw two poses of each tail group and of the floor: the first row's median and 90th percentile."""
    poses = evaluation_poses(table)
    clouds = evaluation_clouds(CloudStream(load_body(), "cpu", CLOUDS.get(kind, Variety())), poses)
    parts = [*clouds["tail"], *clouds["floor"]]
    groups = np.concatenate([table.arrays["tail_group"], np.full(len(poses["floor"]), len(GROUPS))])
    answers = {name: np.concatenate([landmarks(model, part) for part in parts]) for name, model in models.items()}
    truth = np.concatenate([part.targets.numpy() for part in parts])
    points = [cloud[seen].numpy() for part in parts for cloud, seen in zip(part.points, part.seen, strict=True)]
    error = np.sqrt(np.nanmean(((next(iter(answers.values())) - truth) ** 2).sum(-1), axis=1))
    rows = representative(error, groups)
    answers = {name: told[rows] for name, told in answers.items()}
    network = load_network()
    answers["ours, ships"] = np.concatenate([network(points[row][None]).positions for row in rows])
    titles = [f"{(*GROUPS, 'floor')[groups[row]]}, {100 * SHOWN[i % len(SHOWN)]:.0f} %" for i, row in enumerate(rows)]
    draw_tail(out, truth[rows], [points[row] for row in rows], titles, answers)


if __name__ == "__main__":
    main()
