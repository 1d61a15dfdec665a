"""The walk of a folder through the reader stays short enough to follow."""

from __future__ import annotations

from pathlib import Path

from tests.support.trial_files import write_trial
from tests.support.walk import climbs, stops_of


def test_a_folder_of_views_takes_few_stops_and_climbs(tmp_path: Path) -> None:
    write_trial(tmp_path, frames=60)
    stops = stops_of(tmp_path)
    assert {"io/captures/detection_folders", "agreement/person_selection"} <= {stop.module for stop in stops}
    assert len(stops) <= 100 and climbs(stops) <= 10, (len(stops), climbs(stops))
