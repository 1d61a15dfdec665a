"""Every code of a warning or an error is explained by the command line."""

import json
import re
from pathlib import Path

import pytest

from solver_backend.cli.explain import list_errors
from solver_backend.cli.main import main
from solver_backend.exchange.diagnostics import list_refusals, load_table
from solver_backend.exchange.errors import ExitCode, FileDamaged, MocapError


def test_every_diagnostic_is_explained_with_cause_and_remedy(capsys: pytest.CaptureFixture[str]) -> None:
    for code, entry in list(load_table().items())[::25]:
        assert main(["explain", code]) == ExitCode.RESULT
        shown = capsys.readouterr().out
        assert shown.startswith(f"{code}: {entry.severity.value}") and entry.cause in shown
        assert ("What to do:" in shown) == bool(entry.remedy) and "{" not in shown


def test_what_can_refuse_a_result_says_how_to_accept_it(capsys: pytest.CaptureFixture[str]) -> None:
    code = list_refusals()[0]
    main(["explain", code.upper()])
    assert f"--accept {code} keeps the result" in capsys.readouterr().out


def test_an_error_is_explained_and_a_misspelled_code_is_corrected(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "file_missing", "--json"]) == ExitCode.RESULT
    result = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert result["code"] == "file_missing" and result["severity"] == "error" and result["text"]
    main(["explain", "file_damaged"])
    assert "What to do: Correct the file" in capsys.readouterr().out
    assert main(["explain", "camera_turnd"]) == ExitCode.USAGE
    assert "Did you mean camera_turned?" in capsys.readouterr().err


def test_without_a_code_all_codes_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain"]) == ExitCode.RESULT
    shown = capsys.readouterr().out
    listed = {line.split()[0] for line in shown.splitlines() if line.startswith("  ")}
    assert listed == {*load_table(), *codes("solver_backend"), "studio_invalid"}
    assert main(["explain", "--json"]) == ExitCode.RESULT
    result = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert {row["code"] for row in result["codes"]} == listed


def codes(folder: str) -> set[str]:
    """Return the codes of the errors that a folder's modules define."""
    files = (Path(__file__).resolve().parents[2] / folder).rglob("*.py")
    texts = [path.read_text(encoding="utf-8") for path in files]
    names = {name for text in texts for name in re.findall(r"^class (\w+)\(.*MocapError\)", text, re.MULTILINE)}
    return {re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower() for name in names}


def test_every_error_of_the_solver_is_explained(capsys: pytest.CaptureFixture[str]) -> None:
    for code in [*codes("solver_backend"), "studio_invalid"]:
        assert main(["explain", code]) == ExitCode.RESULT
        assert capsys.readouterr().out.startswith(f"{code}: {'warning' if code in load_table() else 'error'}")


def test_an_error_of_the_add_on_alone_is_not_taken_for_another(capsys: pytest.CaptureFixture[str]) -> None:
    own = codes("blender_addon") - codes("solver_backend")
    assert own
    for code in own:
        assert main(["explain", code]) == ExitCode.USAGE
        assert "Did you mean" not in capsys.readouterr().err


def test_an_error_of_another_program_is_not_listed() -> None:
    class Elsewhere(MocapError):
        """Another program has ended."""

        code = "elsewhere"

    assert Elsewhere.code not in list_errors()


def test_an_error_without_a_hint_has_the_remedy_of_its_class() -> None:
    assert str(FileDamaged("The file is empty.", where="a.npz")).startswith(
        "The file is empty (a.npz). Correct the file"
    )
    assert FileDamaged("The file is empty.", hint="Copy it again.").hint == "Copy it again."
    assert not MocapError("Something failed.").hint
