"""Tests of alternatives: how the planner would have driven on with other values."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from applr_ros1.planner.parameters.parameter import by_name
from applr_ros1.planner.parameters.settings import Change
from applr_ros1.why import alternatives
from applr_ros1.why.alternatives import Alternative, MeanResult, guesses_of
from applr_ros1.why.diagnosis import diagnose
from applr_ros1.why.events import Event
from applr_ros1.why.replay import History, Replay
from tests.support.replays import (
    PLANNER,
)


def test_the_spoilt_parameter_is_the_first_guess_and_every_guess_gains_speed(replay, monkeypatch):
    # Fewer cycles than people get, because each takes the time of a drive.
    monkeypatch.setattr(alternatives, "CYCLES", 4)
    guesses = guesses_of(diagnose(replay))
    assert guesses[0].change.name == "vx_samples"
    for guess in guesses:
        assert guess.gain > 0.0


def test_alternatives_begin_on_the_way_into_an_event(sound, monkeypatch):
    begin_times = []

    def best_changes(replay, changes, cycles):
        begin_times.extend(cycle.at for cycle in cycles)
        return []

    monkeypatch.setattr(alternatives, "best_changes", best_changes)
    guesses_of(diagnose(sound, at=5.0))
    # The event of a moment is half a second around it. The way into it counts from 2 s before.
    assert min(begin_times) == pytest.approx(2.5, abs=0.1)
    assert max(begin_times) == pytest.approx(5.5, abs=0.1)


def test_each_event_is_tried_from_some_early_cycles_and_a_longer_one_from_more(monkeypatch):
    tried_from = []

    def best_changes(replay, changes, cycles):
        tried_from.extend(cycle.at for cycle in cycles)
        return []

    monkeypatch.setattr(alternatives, "best_changes", best_changes)
    monkeypatch.setattr(alternatives, "changes_to_try", lambda replay: [])
    cycles = [SimpleNamespace(at=row / 20, reproduced=True) for row in range(200)]
    replay = Replay(recording=None, planner=None, history=None, cycles=cycles, left_out={})
    short_event = Event("stood", 3.0, 3.45, (0.0, 0.0))  # 10 cycles
    long_event = Event("crept", 6.0, 8.45, (1.0, 0.0))  # 50 cycles

    guesses_of(SimpleNamespace(replay=replay, events=[short_event, long_event], part=None))

    # A sixth of the eight cycles is one, but each event has three. The first one is 2 s before it,
    # and the second one comes after a quarter of the time.
    assert tried_from[:3] == pytest.approx([1.0, 1.6, 3.45])
    # Five sixths are seven, most of them on the way into the event.
    long_times = tried_from[3:]
    assert len(long_times) == 7
    assert (long_times[0], long_times[-1]) == (4.0, 8.45)
    assert np.median(long_times) < long_event.begin


def test_driving_on_follows_the_commands(replay):
    cycle = replay.cycles[100]
    ((speed, distance),) = alternatives.drive_on(replay, [cycle])
    assert speed == pytest.approx(0.1, abs=0.03)  # the only speed
    assert 0.2 < distance < 3.0

    more_samples = Change(PLANNER, "vx_samples", 1, 20)
    ((higher_speed, _),) = alternatives.drive_on(replay, [cycle], [more_samples])
    assert higher_speed > 0.2

    # Symmetric limits stay so.
    slower_turns = Change(PLANNER, "max_vel_theta", 1.57, 1.0)
    changed_settings = cycle.settings.with_(*alternatives.together(cycle.settings, slower_turns))
    assert changed_settings[PLANNER]["min_vel_theta"] == -1.0

    # Others stay as they are.
    slower_right_turns = Change(PLANNER, "min_vel_theta", -1.57, -0.5)
    skewed_settings = cycle.settings.with_(slower_right_turns)
    assert alternatives.together(skewed_settings, slower_turns) == (slower_turns,)


def test_nearly_equal_alternatives_are_ordered_by_departure_from_the_default(replay):
    declared = by_name(replay.planner.parameters(PLANNER))

    def alternative(name, before, after, gain):
        change = Change(PLANNER, name, before, after)
        default = declared[name].default
        stands = MeanResult(0.0, 0.0)
        gains = MeanResult(gain, 0.0)
        return Alternative((change,), default, stands, gains)

    # The first four gain about as much (at least WITHIN of the best), so that small changes are
    # preferred. vx_samples gains too little for that.
    tried = [
        alternative("sim_time", 2.0, 8.0, 1.0),
        alternative("sim_time", 2.0, 1.7, 0.92),
        alternative("occdist_scale", 0.1, 0.01, 0.95),
        alternative("occdist_scale", 0.1, 0.05, 0.93),
        alternative("vx_samples", 1, 20, 0.5),
    ]
    values_in_order = [each.change.after for each in alternatives.ranked(tried)]
    assert values_in_order == [0.05, 0.01, 1.7, 8.0, 20]


def test_the_best_value_of_each_parameter_is_left_that_fits_past_obstacles(replay, monkeypatch):
    faster = Change(PLANNER, "sim_time", 2.0, 1.0)
    slower = Change(PLANNER, "sim_time", 2.0, 4.0)
    other = Change(PLANNER, "occdist_scale", 0.1, 0.05)
    little = Change(PLANNER, "path_distance_bias", 0.75, 0.6)

    def values_left(clearance_before, clearance_of_faster):
        """Return the values that are left, the best first, with these clearances [m]."""
        # Speed [m/s] and smallest distance of obstacles [m]
        results = {
            None: (0.1, clearance_before),
            faster: (0.5, clearance_of_faster),
            slower: (0.3, 0.5),
            other: (0.2, 0.5),
            little: (0.105, 0.5),
        }

        def drive_on(replay, cycles, changes=(None,)):
            return np.array([results[changes[0]]] * len(cycles))

        monkeypatch.setattr(alternatives, "drive_on", drive_on)
        tried = [(slower,), (faster,), (little,), (other,)]
        kept = alternatives.best_changes(replay, tried, replay.cycles[:4])
        assert kept[-1].gain == pytest.approx(0.1)
        return [alternative.change.after for alternative in kept]

    # A circle of 0.265 m fits into the Jackal's padded footprint: at 0.35 m it passes.
    assert values_left(clearance_before=0.5, clearance_of_faster=0.35) == [1.0, 0.05]
    assert values_left(clearance_before=0.5, clearance_of_faster=0.15) == [4.0, 0.05]
    # A robot that was nearer already may stay so, but come no nearer.
    assert values_left(clearance_before=0.1, clearance_of_faster=0.15) == [1.0, 0.05]
    assert values_left(clearance_before=0.2, clearance_of_faster=0.15) == [4.0, 0.05]


def test_values_are_tried_up_to_the_default_and_none_that_the_owner_sets(replay):
    def changes_from(sim_time):
        """Return the changes that are tried from a value of sim_time, whose default is 1.7 s."""
        change = Change(PLANNER, "sim_time", 2.0, sim_time)
        history = History([-np.inf], [replay.settings.with_(change)])
        return alternatives.changes_to_try(replace(replay, history=history))

    for sim_time, expected in (
        (5.0, [2.5, 10.0, 1.7]),  # the default, half and twice the value
        (2.0, [1.7, 4.0]),  # Half of it lies beyond the default.
        (1.0, [1.7, 0.5]),  # So does twice this value.
        (1.8, [3.6]),  # The default is less than a tenth away.
    ):
        changes = changes_from(sim_time)
        values = [change.after for (change, *_) in changes if change.name == "sim_time"]
        assert values == expected, sim_time

    names = {change.name for (change, *_) in changes_from(2.0)}
    assert {"sim_time", "vx_samples", "inflation_radius"} <= names
    assert not names & {"max_vel_x", "min_vel_x", "escape_vel", "holonomic_robot", "dwa"}


def test_another_inflation_applies_to_the_recorded_map(replay):
    """With a wide one, the planner passes obstacles at another distance."""
    layer = "local_costmap/inflater_layer"
    cycle = replay.cycles[100]
    tracks = []
    for radius in (0.1, 1.0):
        wider = cycle.settings.with_(Change(layer, "inflation_radius", 0.3, radius))
        tracks.append(replay.ahead(cycle, wider, 40).track)
    assert not np.array_equal(*tracks)
    # The recorded map itself keeps its own inflation.
    assert replay.at(cycle).command == pytest.approx(cycle.command)
