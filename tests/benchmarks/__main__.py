"""Run benchmarks and compare them with ``baseline.json``. The exit code is 1 if one is worse, 2 for an unknown name."""

from __future__ import annotations

import argparse
import importlib
import json
import os
import pkgutil
import platform
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import tests.benchmarks
from blender_addon.headless.process import leave
from tests.benchmarks.metric import BenchmarkSkipped, Metric, judge

BASELINE = Path(__file__).with_name("baseline.json")
PREFIX = "bench_"


def main(argv: list[str] | None = None, baseline_path: Path = BASELINE) -> int:
    """Run the chosen benchmarks, or all if none is named."""
    names = discover()
    parser = argparse.ArgumentParser(prog="dev.py bench", description="Benchmarks against their committed baseline.")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"one or more of: {', '.join(names)}")
    parser.add_argument("--update", action="store_true", help="record the figures as the new baseline")
    args = parser.parse_args(argv)
    unknown = sorted(set(args.names) - set(names))
    if unknown:
        print(f"There is no benchmark {', '.join(unknown)}. There are: {', '.join(names)}.", file=sys.stderr)
        return 2
    results = {name: run(name) for name in args.names or names}
    # Read last, because another run may have recorded its figures meanwhile.
    baseline = json.loads(baseline_path.read_text(encoding="utf-8")) if baseline_path.exists() else {}
    if args.update:
        baseline |= {name: record(metrics) for name, metrics in results.items() if metrics is not None}
        baseline_path.write_text(json.dumps(baseline, indent=2, sort_keys=True) + "\n", encoding="utf-8")
        print(f"Recorded in {baseline_path.name}.")
        return 0
    passed = [
        compare(name, metrics, baseline.get(name, {})) for name, metrics in results.items() if metrics is not None
    ]
    return 0 if all(passed) else 1


def discover() -> list[str]:
    """Return the names of the benchmarks, which are modules ``bench_NAME`` in this folder."""
    found = (module.name for module in pkgutil.iter_modules(tests.benchmarks.__path__))
    return sorted(name.removeprefix(PREFIX) for name in found if name.startswith(PREFIX))


def run(name: str) -> list[Metric] | None:
    """Print a benchmark's description, then run it. Return None if it cannot run here."""
    module = importlib.import_module(f"tests.benchmarks.{PREFIX}{name}")
    method = " ".join((module.__doc__ or "").split())
    print(f"\n{name}: {method}", flush=True)
    try:
        metrics: list[Metric] = module.run()
    except BenchmarkSkipped as reason:
        print(f"  skipped: {reason}")
        return None
    for metric in metrics:
        print(f"    {metric.key:<30} {metric.value:12.4g} {metric.unit}", flush=True)
    return metrics


def record(metrics: list[Metric]) -> dict[str, Any]:
    """Return figures in the form of the baseline, with the machine and the UTC date of the measurement."""
    return {
        "machine": machine(), "recorded": datetime.now(UTC).date().isoformat(),
        "figures": {m.key: {"value": round(m.value, 5), "unit": m.unit} for m in metrics},
    }  # fmt: skip


def compare(name: str, metrics: list[Metric], known: dict[str, Any]) -> bool:
    """Print every figure with its baseline, and return whether all pass."""
    print(f"\n{name} against its baseline:")
    figures = {key: item["value"] for key, item in known.get("figures", {}).items()}
    verdicts, lost = judge(metrics, figures)
    for verdict in verdicts:
        print(verdict.line())
    for key in lost:
        print(f"  ✗ {key:<30} stands in the baseline and was not measured")
    if known.get("machine") not in (None, machine()):
        print(f"  (the baseline of {name} was measured on: {known['machine']})")
    return not lost and all(verdict.passed for verdict in verdicts)


def machine() -> str:
    """Return the properties of the machine that affect times: system, architecture, cores and Python."""
    return f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"


if __name__ == "__main__":
    leave(main())  # Blender as a module may wait forever at the end
