"""Only a page that a solve wrote beside its take is taken for a report."""

from __future__ import annotations

import re
from base64 import b64encode
from hashlib import sha256
from pathlib import Path

from solver_backend.exchange.marker_formats import REPORT_MARK, is_report
from solver_backend.report.page import report_html
from tests.support.scenes import small_capture, small_motion


def test_a_report_is_known_by_ending_place_and_head(tmp_path: Path) -> None:
    page = report_html(small_capture(6), small_motion(6))
    ours, elsewhere = tmp_path / "take.html", tmp_path / "below" / "take.html"
    elsewhere.parent.mkdir()
    for path in (ours, elsewhere, tmp_path / "take.exe"):
        path.write_text(page)
    (tmp_path / "other.html").write_text("<!doctype html><title>A page</title>" + " " * 3000 + REPORT_MARK)
    (tmp_path / "link.html").symlink_to(elsewhere)
    assert is_report(ours, tmp_path)
    for name in ("below/take.html", "take.exe", "other.html", "link.html", "none.html", "below"):
        assert not is_report(tmp_path / name, tmp_path)


def test_nothing_but_the_pages_own_style_and_script_works() -> None:
    page = report_html(small_capture(6), small_motion(6))
    [policy] = re.findall(r'http-equiv="Content-Security-Policy" content="([^"]*)"', page)
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'none'"
    for name, rule in (("style", "style-src-elem"), ("script", "script-src")):
        [own] = re.findall(f"<{name}>(.*?)</{name}>", page, re.DOTALL)
        assert rules[rule] == f"'sha256-{b64encode(sha256(own.encode()).digest()).decode()}'"
    assert page.index("Content-Security-Policy") < page.index("<style>")
    assert not re.search(r"\son\w+=", re.sub(r"<script>.*?</script>", "", page, flags=re.DOTALL))
    assert all(re.fullmatch(r"--h:\d+%", value) for value in re.findall(r'style="([^"]*)"', page))
