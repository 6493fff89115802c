"""Tests of the demo's counts of skipped cycles and late decisions."""

import pytest
import rospy

from applr_ros1.nodes.conversions import diagnostics
from applr_ros1.nodes.move_base.reports import SKIPPED
from applr_ros1.nodes.tools.machine_load import LATE, MachineLoad


def report(load, **counters):
    """Take a report with counters."""
    load.read_diagnostics(
        diagnostics("name", 0, "", {"another": "text", **counters}, rospy.Time(1))
    )


def driven(skipped, decisions, late):
    """Return the load of a drive with these counts, after a start that was busy as well."""
    load = MachineLoad()
    report(load, skipped_cycles=70)
    report(load, decisions=3, late=2)
    load.begin()
    report(load, skipped_cycles=70 + skipped)
    report(load, decisions=3 + decisions, late=2 + late)
    return load


def test_the_counts_are_those_of_the_drive():
    load = driven(26, 5, 1)
    assert (load.count(SKIPPED), load.count(LATE)) == (26, 1)


@pytest.mark.parametrize(
    ("skipped", "decisions", "late", "problem"),
    [
        (0, 0, 0, ""),
        (9, 20, 1, ""),
        (10, 20, 1, "move_base skipped 10 of 100 cycles;"),
        (9, 20, 2, "2 of 20 decisions were late;"),
        (26, 5, 1, "move_base skipped 26 of 100 cycles and 1 of 5 decisions were late;"),
    ],
)
def test_a_tenth_of_the_cycles_or_decisions_spoils_a_drive(skipped, decisions, late, problem):
    sentence = driven(skipped, decisions, late).sentence(100)
    assert problem in sentence
    assert sentence.startswith("this machine was too busy: ") is bool(problem)


def test_both_nodes_must_have_reported():
    load = MachineLoad()
    report(load, skipped_cycles=0)
    assert not load.is_reported
    report(load, decisions=1, late=0)
    assert load.is_reported
    load.expect_reports()
    assert not load.is_reported
