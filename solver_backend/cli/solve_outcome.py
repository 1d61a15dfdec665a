"""What a solve hands back: what was found goes into the motion, the text, the JSON and the summary alike."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from solver_backend.cli.describe import describe_motion
from solver_backend.cli.outcome import Outcome, note_lines
from solver_backend.exchange.diagnostics import Diagnostic, sentence, summarise, warnings_in
from solver_backend.exchange.errors import WarningsRefused
from solver_backend.exchange.verb_results import SolveResult
from solver_backend.job import Job
from solver_backend.types import Motion


def record_found(job: Job, motion: Motion, found: Sequence[Diagnostic], solve_s: float) -> Motion:
    """Return the motion as it is written, with what was found.

    Raises:
        WarningsRefused: the job is strict, and there are warnings.
    """
    warnings = warnings_in(found)
    if job.strict and warnings:
        raise WarningsRefused(
            f"The solve has {len(warnings)} warning{'s' * (len(warnings) > 1)} and was to be strict: "
            + " ".join(sentence(item, motion.fps) for item in warnings),
            where=str(job.capture), hint="Nothing was written; solve without --strict to look at the result.",
        )  # fmt: skip
    record = {key: value for key, value in motion.provenance.items() if key != "findings"}
    record |= {"solve_s": round(solve_s, 2), "diagnostics": [item.as_dict() for item in found]}
    return replace(motion, provenance=record)


def outcome_of(
    job: Job, motion: Motion, found: Sequence[Diagnostic], solve_s: float, person: str = ""
) -> Outcome[SolveResult]:
    """Return what is reported of a solve that was written.

    Args:
        job: names the files.
        motion: as it was written.
        found: all diagnostics.
        solve_s: seconds that solving took.
        person: whose motion it is, where the views show several people.
    """
    text, data = describe_motion(motion, solve_s)
    written = {"motion": str(job.out), "report": None if job.report is None else str(job.report)}
    files = [f"  {name:<11} {path}" for name, path in written.items() if path]
    result: SolveResult = {
        "motion": str(job.out), "report": written["report"], **data, "diagnostics": [item.as_dict() for item in found],
    }  # fmt: skip
    if person:
        result["person"] = person
    return Outcome(
        "\n".join([text, *note_lines(found, motion.fps), *files]), result, tuple(summarise(found, motion.fps))
    )
