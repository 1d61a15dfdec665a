"""The page about the job file is made from the classes that declare its keys."""

from pathlib import Path

import pytest

from supply import job_file_page


def test_a_key_without_a_description_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = job_file_page._SOURCE.read_text(encoding="utf-8")
    changed = source.replace("  # Replace existing results.", "")
    assert changed != source and "`overwrite`" in job_file_page.job_file_page()
    (tmp_path / "job_file.py").write_text(changed, encoding="utf-8")
    monkeypatch.setattr(job_file_page, "_SOURCE", tmp_path / "job_file.py")
    with pytest.raises(ValueError, match=r"JobFile\.overwrite"):
        job_file_page.job_file_page()
