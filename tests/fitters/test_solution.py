"""What a solve says of how it ended."""

import pytest

from solver_backend.fitters import SolveSettings, solve
from solver_backend.fitters.problem import Convergence
from solver_backend.synthesis.embedded.demo import demo_capture


@pytest.mark.parametrize(
    ("parts", "sentence"),
    [
        ([(1, 1, 3)], "Converged: the cost no longer changes after 3 linearisations."),
        ([(1, 1, 3), (1, 1, 5)], "Converged: the cost no longer changes after 5 linearisations."),
        ([(1, 0, 8)], "Stopped after 8 linearisations. More iterations may help."),
        (
            [(1, 0, 8), (1, 1, 2)],
            "Stopped after 8 linearisations in 1 of 2 parts of the take. More iterations may help.",
        ),
    ],
)
def test_one_sentence_for_all_parts(parts, sentence):
    assert Convergence.joined(Convergence(*part) for part in parts).status.startswith(sentence)


@pytest.mark.parametrize(("iterations", "word"), [(1, "Stopped after 1"), (60, "Converged")])
def test_the_status_is_returned_and_recorded(iterations, word):
    capture = demo_capture(num_frames=8)
    solution = solve(capture, SolveSettings(method="frame", iterations=iterations))
    assert solution.status.startswith(word)
    assert solution.motion.provenance["status"] == solution.status
