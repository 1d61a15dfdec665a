"""The walk of a folder through the reader stays short enough to follow."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.recordings import ABSENT, recordings_folder
from tests.support.trial_files import write_trial
from tests.support.walk import climbs, stops_of

RECORDED = (
    "pose2sim/S00_P00_SingleParticipant/S00_P00_T01_BalancingTrial",
    "pose2sim_session/S00_P01_MultiParticipants/S00_P01_T02_Participants1-2",
)


def check_walk(folder: Path) -> None:
    stops = stops_of(folder)
    assert {"io/captures/detection_folders", "agreement/person_selection"} <= {stop.module for stop in stops}
    assert len(stops) <= 100 and climbs(stops) <= 10, (len(stops), climbs(stops))


def test_a_folder_of_views_takes_few_stops_and_climbs(tmp_path: Path) -> None:
    write_trial(tmp_path, frames=60)
    check_walk(tmp_path)


@pytest.mark.parametrize("name", RECORDED)
def test_a_recording_takes_few_stops_and_climbs(name: str) -> None:
    folder = recordings_folder() / "multiview" / name
    if not folder.is_dir():
        pytest.skip(ABSENT)
    check_walk(folder)
