"""Tests of the rows that grow while a robot drives."""

import numpy as np
import pytest

from applr_ros1.drives.drive import Changes, Motion
from applr_ros1.drives.recorder import Recorder, RowLog


def test_a_log_grows_and_leaves_the_rows_that_were_read():
    log = RowLog(Motion)
    earlier_rows = None
    for number in range(1000):
        log.append(time=number, stamp=number, pose=(number, 1.0, 2.0), twist=(3.0, number))
        if number == 99:
            earlier_rows = log.rows
    np.testing.assert_array_equal(log.rows.time, np.arange(1000))
    np.testing.assert_array_equal(log.rows.pose[:, 0], np.arange(1000))
    np.testing.assert_array_equal(earlier_rows.twist[:, 1], np.arange(100))


def test_lists_of_a_log_are_copies():
    log = RowLog(Changes)
    log.append(time=0.0, server="planner", values={})
    rows = log.rows
    log.append(time=1.0, server="costmap", values={})
    assert rows.server == ["planner"]
    assert log.rows.server == ["planner", "costmap"]


def test_a_row_without_one_of_its_fields_is_an_error():
    with pytest.raises(KeyError, match="twist"):
        Recorder().add_row("commands", 0.0)


def test_columns_without_rows_keep_their_width():
    drive = Recorder(everything=True).drive
    assert drive.commands.twist.shape == (0, 2)
    assert drive.scans.fan.shape == (0, 4)
    assert drive.odometry is None
    assert drive.transforms is None
