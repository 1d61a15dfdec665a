"""What a file says cannot steer the terminal, panel or page that shows it."""

from __future__ import annotations

import io
import sys
from types import SimpleNamespace

import pytest

from solver_backend.exchange.command import Report
from solver_backend.exchange.errors import FileMissing
from solver_backend.exchange.plain_text import plain
from solver_backend.exchange.progress import ConsoleProgress
from solver_backend.report.markup import text

HOSTILE = "a\x1b[2Jb\rc\x07\x9bd\u202egpj.exe\u2066\u2028\x00\ud800"


@pytest.mark.parametrize("kept", ["Übung 1 – «α» 東京", "می\u200cخواهم", "👩\u200d👧", "tab/\\'\"<>"])
def test_writing_of_people_stays_as_it_is(kept: str) -> None:
    assert plain(kept) == kept


def test_what_steers_is_shown_as_a_sign() -> None:
    assert plain(HOSTILE) == "a\ufffd[2Jb\ufffdc\ufffd\ufffdd\ufffdgpj.exe\ufffd\ufffd\ufffd\ufffd"
    assert plain("a\nb") == "a\ufffdb"
    assert plain("a\nb", keep="\n") == "a\nb"


def test_terminal_and_page_show_it_plain(capsys: pytest.CaptureFixture[str]) -> None:
    stream = io.StringIO()
    report = Report(stream, sys.stderr, as_json=False)
    report.result({}, f"Read {HOSTILE}\n  next", [HOSTILE])
    report.error(FileMissing(HOSTILE, where=HOSTILE, hint=HOSTILE))
    ConsoleProgress(stream)(HOSTILE, 1, 1)
    shown = stream.getvalue() + capsys.readouterr().err + str(FileMissing(HOSTILE)) + text(HOSTILE)
    assert not set(shown) & set("\x1b\r\x07\x9b\u202e\u2066\u2028\x00\ud800")
    assert stream.getvalue().splitlines()[1] == "  next"


def test_a_message_of_a_capture_is_plain_in_the_panel(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("bpy")
    from blender_addon.ui import layout

    monkeypatch.setattr(layout, "_lines", lambda context, text, with_icon: [text])
    shown: list[str] = []
    column = SimpleNamespace(label=lambda text, **_: shown.append(text))
    layout.wrapped(SimpleNamespace(column=lambda align: column), None, HOSTILE, "ERROR")  # type: ignore[arg-type]
    assert len(shown) == 1 and not set(shown[0]) & set("\x1b\r\x07\x9b\u202e\u2066\u2028\x00\ud800")
