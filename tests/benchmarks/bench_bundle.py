"""Compare methods on the same benchmark captures: accuracy, smoothness, feet, exchanges, reprojection, time and memory.

``python3 dev.py bench bundle`` measures the figures of the baseline: our method and the published method, and three
methods by the number of cameras. ``python -m tests.benchmarks.bench_bundle`` prints every table of all methods, or some
of them with ``--tables methods,views --takes N --quick``. Figures are medians over takes. Every run is kept under
build/bench_bundle and not repeated while its code and capture do not change. Needs the validation motions
(MOCAP_SHARED_DATA).
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
from dataclasses import asdict

import numpy as np

from tests.benchmarks.comparison.captures import TAKES
from tests.benchmarks.comparison.methods import PUBLISHED
from tests.benchmarks.comparison.passage import hardest
from tests.benchmarks.comparison.passage_video import render_apart
from tests.benchmarks.comparison.plots import error_against_time, knee_flexion
from tests.benchmarks.comparison.requirements import requirements
from tests.benchmarks.comparison.runs import ROOT, outcomes
from tests.benchmarks.comparison.sections import SECTIONS, VIEWS, Found, Scope, Section, medians, quick
from tests.benchmarks.metric import Metric

OUT = ROOT / "build" / "bench_bundle"
UNITS = {
    "mpjpe_mm": "MPJPE", "pa_mpjpe_mm": "PA-MPJPE", "rmse_mm": "RMSE", "mae_deg": "MAE °", "pck3": "PCK3",
    "pck7": "PCK7", "accel_m_s2": "accel", "kp_mpjpe_mm": "points", "kp_accel_m_s2": "p.accel",
    "skating_cm_f": "skating", "reproj_px": "reproj", "undone": "undone", "seen_mm": "seen",
    "unseen_mm": "unseen", "seconds": "s", "cpu_s": "CPU s", "peak_mb": "MB",
}  # fmt: skip
"""Column titles. Units are mm, degrees, percent, m/s², cm per frame and px."""


def table(section: Section, found: Found) -> str:
    """Return a section as text."""
    rows = section.medians(found)
    width = max(len(label) for label in rows) + 2
    lines = [f"{'':<{width}}" + "".join(f"{UNITS.get(c, c):>10}" for c in section.columns)]
    for label, row in rows.items():
        lines.append(f"{label:<{width}}" + "".join(_cell(row.get(column, float("nan"))) for column in section.columns))
    return "\n".join(lines)


def _cell(value: float) -> str:
    if not np.isfinite(value):
        return f"{'-':>10}"
    return f"{value:10.3f}" if abs(value) < 1 else f"{value:10.2f}" if abs(value) < 1000 else f"{value:10.0f}"


def measured(names: list[str], scope: Scope, jobs: int = 1) -> tuple[dict[str, Section], Found]:
    """Return the sections and the results of their runs."""
    sections = {name: SECTIONS[name](scope) for name in names}
    return sections, _solved(sections, jobs)


def _solved(sections: dict[str, Section], jobs: int = 1) -> Found:
    runs = list(dict.fromkeys(run for section in sections.values() for run in section.runs))
    return outcomes(runs, lambda line: _say(line + "\n", sys.stderr), jobs)


def run() -> list[Metric]:
    """Print the recorded rows. Return our figures, and their ratios to the published method."""
    sections = {name: SECTIONS[name](Scope()) for name in ("methods", "views")}
    sections["methods"] = sections["methods"].only("ours, global", PUBLISHED)
    found = _solved(sections)
    report(sections, found)
    rows = sections["methods"].medians(found)
    ours, published = rows["ours, global"], rows[PUBLISHED]
    return [
        Metric("mpjpe_mm", ours["mpjpe_mm"], "mm"),
        Metric("accel_m_s2", ours["accel_m_s2"], "m/s²", rel_tol=0.1),
        Metric("mpjpe_ratio", ours["mpjpe_mm"] / published["mpjpe_mm"], ""),
        Metric("accel_ratio", ours["accel_m_s2"] / published["accel_m_s2"], "", rel_tol=0.1),
        Metric("cpu_ratio", ours["cpu_s"] / published["cpu_s"], "", rel_tol=0.2),
        Metric("seconds_ratio", ours["seconds"] / published["seconds"], "", rel_tol=1.0),
        *by_views(sections["views"].medians(found)),
    ]


def by_views(rows: dict[str, dict[str, float]]) -> list[Metric]:
    """Return the errors of three methods by number of cameras."""
    methods = {"ours": "ours, global", "published": PUBLISHED, "muvs": "MuVS"}
    return [
        Metric(f"views_{count}_{key}_mpjpe_mm", rows[f"{name}, {count} views"]["mpjpe_mm"], "mm")
        for key, name in methods.items()
        for count in VIEWS
    ]


def report(sections: dict[str, Section], found: Found) -> None:
    """Print the tables and the requirements, and write both as JSON."""
    for section in sections.values():
        takes = ", ".join(dict.fromkeys(f"{run.take} (seed {run.settings.seed})" for run in section.runs))
        _say(f"\n{section.title}; medians over {takes}\n{table(section, found)}\n")
    wanted = requirements({name: section.medians(found) for name, section in sections.items()})
    if wanted:
        _say("\nRequired of ours:\n" + "\n".join(item.line() for item in wanted) + "\n")
    _say(f"\n{machine()}\n")
    OUT.mkdir(parents=True, exist_ok=True)
    (OUT / "results.json").write_text(json.dumps(_plain(sections, found), indent=1) + "\n", encoding="utf-8")


def illustrate(section: Section, found: Found, *, video: bool = True) -> None:
    """Write the plots, and the video of the hardest passage if requested."""
    error_against_time(OUT / "error_against_time.svg", section.medians(found))
    passage = hardest(section, found)
    knee_flexion(OUT / "knee_flexion.svg", passage)
    if video:
        render_apart(passage, OUT / "passage.mp4")
    errors = ", ".join(f"{label} {error:.0f} mm" for label, error in list(passage.errors_mm().items())[1:])
    _say(f"Hardest passage: {passage.take} from its frame {passage.first}: {errors}. Written to {OUT.name}.\n")


def machine() -> str:
    """Return the properties of the machine that affect times."""
    threads, load = os.environ.get("OMP_NUM_THREADS", "all"), os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
    return f"{platform.platform()}, {os.cpu_count()} cores, {threads} threads, load {load:.1f} at the end"


def _plain(sections: dict[str, Section], found: Found) -> dict:
    def rows(section: Section) -> dict[str, dict]:
        return {
            label: {
                "median": medians([found[run].row for run in runs]),
                "runs": [{"take": run.take, **asdict(run.settings), "bad": run.bad, **found[run].row,
                          "worst": found[run].worst, "notes": found[run].notes} for run in runs],
            }
            for label, runs in section.rows.items()
        }  # fmt: skip

    return {"machine": machine(), "tables": {n: {"title": s.title, "rows": rows(s)} for n, s in sections.items()}}


def _say(text: str, stream=sys.stdout) -> None:
    stream.write(text)
    stream.flush()


def main(argv: list[str]) -> int:
    """Print the chosen tables."""
    parser = argparse.ArgumentParser(prog="bench_bundle", description="All methods on the same benchmark captures.")
    parser.add_argument("--tables", default=",".join(SECTIONS), help=f"of {', '.join(SECTIONS)}")
    parser.add_argument("--takes", type=int, default=3, help=f"how many, at most {len(TAKES)}")
    parser.add_argument("--frames", type=int, help="cut every take to so many")
    parser.add_argument("--quick", action="store_true", help="one take of 200 frames")
    parser.add_argument("--jobs", type=int, default=1, help="runs at a time; times are honest with one alone")
    parser.add_argument("--no-video", action="store_true", help="leave out the comparison video")
    args = parser.parse_args(argv)
    names = args.tables.split(",")
    if unknown := sorted(set(names) - set(SECTIONS)):
        parser.error(f"there is no table {', '.join(unknown)}; there are {', '.join(SECTIONS)}")
    scope = Scope(TAKES[: args.takes], args.frames)
    sections, found = measured(names, quick(scope) if args.quick else scope, args.jobs)
    report(sections, found)
    if "methods" in sections:
        illustrate(sections["methods"], found, video=not args.no_video)
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
