"""Tests of a drive's columns: who needs some gets a type in which they are there."""

from typing import NamedTuple, Optional, get_type_hints

import numpy as np
import pytest

from applr_ros1.drives.drive import (
    Clearances,
    Drive,
    DriveError,
    Driven,
    DrivenToGoal,
    Goal,
    Measured,
    Scans,
)
from applr_ros1.drives.end_reasons import MeasuredSlip
from applr_ros1.why.recording import Replayable
from tests.support.drives import driven


class WithDistances(NamedTuple):
    clearances: Clearances
    scans: Scans


def test_a_required_type_has_the_columns_of_the_drive():
    drive = driven([0.0, 1.0], np.zeros((2, 3)))
    drive.goals = [Goal("one", 0.0, 1.0)]
    assert drive.require(DrivenToGoal) == DrivenToGoal(drive.truth, drive.goals)


@pytest.mark.parametrize(
    "scans", [None, Scans(np.empty(0), np.empty(0), fan=np.empty((0, 4)), ranges=[])]
)
def test_the_first_missing_or_empty_column_is_named(scans):
    clearances = Clearances(np.zeros(1), np.ones(1))
    drive = Drive("a drive", clearances=clearances, scans=scans)
    with pytest.raises(DriveError, match="^a drive: it has no scans$"):
        drive.require(WithDistances)
    drive.clearances = None
    with pytest.raises(DriveError, match="^a drive: it has no clearances$"):
        drive.require(WithDistances)


@pytest.mark.parametrize("needed", [Driven, DrivenToGoal, Measured, MeasuredSlip, Replayable])
def test_the_types_that_are_required_have_the_drives_own_columns(needed):
    types_of_columns = get_type_hints(Drive)
    for name, needed_type in get_type_hints(needed).items():
        assert types_of_columns[name] in (needed_type, Optional[needed_type])
