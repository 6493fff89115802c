"""Alternatives: how the planner would have driven on with another value of one parameter.

From each cycle, the planner drives on for AHEAD control cycles on the recorded map; its commands
are followed exactly.
"""

from __future__ import annotations

import logging
import math
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Dict, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.paths import distances, travelled
from applr_ros1.planner.parameters.parameter import by_name
from applr_ros1.planner.parameters.settings import Change, Settings, ratio_of
from applr_ros1.why.diagnosis import Diagnosis
from applr_ros1.why.factors import values_to_try
from applr_ros1.why.replay import Replay, ReplayedCycle, some

_LOGGER = logging.getLogger(__name__)
# Alternatives drive on from so many cycles of all events, and at least so many of each event.
CYCLES = 8
LEAST = 3
LEAD_S = 2.0  # time before an event from which these cycles begin: the way into it shows most [s]
EARLY = 2.0  # how much early ones among them are preferred, see some()
AHEAD = 40  # number of control cycles for which the planner drives on
HEADING = f"Guesses of the replay, {AHEAD} control cycles ahead"  # heading of a list of guesses
FEW = 2  # step between the cycles from which a value is tried first
LITTLE = 0.01  # gain of speed up to which an alternative does not count [m/s]
WITHIN = 0.8  # share of the largest gain from which on alternatives are nearly equal


ChangesTogether = Tuple[Change, ...]  # changes that are tried together; the first one names them


class MeanResult(NamedTuple):
    """Mean result of driving on.

    Attributes:
        speed: Speed along the plan [m/s].
        clearance: Smallest distance of the robot's centre from an obstacle [m].
    """

    speed: float
    clearance: float


@dataclass
class Alternative:
    """Another value of one parameter, with results of `drive_on` from some cycles.

    Attributes:
        changes: The change from the value in force, and what changes with it.
        default: Default of the parameter in the C++ planner.
        before: Result with the value in force.
        after: Result with the other value.
    """

    changes: ChangesTogether
    default: Any
    before: MeanResult
    after: MeanResult

    @property
    def change(self) -> Change:
        """The change that gives the alternative its name."""
        return self.changes[0]

    @property
    def gain(self) -> float:
        """Gain of speed along the plan [m/s]."""
        return self.after.speed - self.before.speed

    @property
    def departure(self) -> Tuple[bool, float, float]:
        """Direction of the change, nearness of the value in force to the default, and its size.

        The direction is True away from the default.
        """
        is_away = self.change.leads_away(self.default)
        return is_away, -ratio_of(self.change.before, self.default), self.change.departure

    def __str__(self) -> str:
        speeds = f"{self.before.speed:.2f} -> {self.after.speed:.2f} m/s along the plan"
        clearances = f"{self.before.clearance:.2f} -> {self.after.clearance:.2f} m from obstacles"
        if not math.isfinite(self.before.clearance + self.after.clearance):
            clearances = "no obstacle seen"
        return f"{self.change}: {speeds}, {clearances}"


def guesses_of(
    diagnosis: Diagnosis, attempts: Optional[Sequence[ChangesTogether]] = None
) -> List[Alternative]:
    """Return alternatives, those with which the planner drives on fastest first.

    Args:
        diagnosis: Diagnosis of a recorded drive.
        attempts: Changes of the values in force that are tried, by default changes_to_try().
    """
    # No parameter helps a robot that stops for a part of itself.
    if diagnosis.part is not None:
        return []
    replay = diagnosis.replay
    cycle_counts = [len(replay.between(event.begin, event.end)) for event in diagnosis.events]
    cycle_total = sum(cycle_counts)
    if not cycle_total:
        return []

    # Longer events count more, but each of them a little.
    tried_from: List[ReplayedCycle] = []
    for event, cycle_count in zip(diagnosis.events, cycle_counts):
        time_share = cycle_count / cycle_total
        cycles_with_lead = replay.between(event.begin - LEAD_S, event.end)
        tried_from += some(cycles_with_lead, max(LEAST, round(CYCLES * time_share)), EARLY)
    if attempts is None:
        attempts = changes_to_try(replay)
    return best_changes(replay, attempts, tried_from)


def changes_to_try(replay: Replay) -> List[ChangesTogether]:
    """Return changes of parameters of the local planner and of the local inflation layers."""
    changes = []
    for server in replay.planner.tunable_servers:
        for parameter in replay.planner.parameters(server):
            in_force = replay.settings[server].get(parameter.name, "")
            if not isinstance(in_force, str):
                for other_value in values_to_try(parameter, in_force):
                    change = Change(server, parameter.name, in_force, other_value)
                    changes.append(together(replay.settings, change))
    return changes


def drive_on(
    replay: Replay, cycles: Sequence[ReplayedCycle], changes: ChangesTogether = ()
) -> np.ndarray:
    """Drive on from cycles, with changes of the values in force.

    Returns:
        (n, 2) mean speeds along the plan [m/s], and smallest distances of the robot's centre from
        an obstacle [m].
    """
    results = []
    for cycle in cycles:
        settings = cycle.settings.with_(*changes) if changes else cycle.settings
        track, lethal_points = replay.ahead(cycle, settings, AHEAD)
        # Every fourth position is near enough to the next one: 0.1 m at 0.5 m/s.
        clearances = distances(track[::4, None], lethal_points)
        speed = _speed_along(cycle.plan, track, AHEAD * replay.planner.period)
        results.append((speed, clearances.min(initial=np.inf)))
    # Without cycles there are no rows, but two columns.
    return np.array(results).reshape(-1, 2)


def _speed_along(plan: np.ndarray, track: np.ndarray, seconds: float) -> float:
    """Return the mean speed [m/s] of a track of some seconds along a plan (n, 3)."""
    points = plan[:, :2]
    way_lengths = travelled(points)

    # Way between the poses of the plan that are nearest to both ends of the track
    first_point = distances(points, track[0]).argmin()
    last_point = distances(points, track[-1]).argmin()
    gained_way = float(way_lengths[last_point] - way_lengths[first_point])
    speed: float = gained_way / seconds
    return speed


def together(settings: Settings, change: Change) -> ChangesTogether:
    """Return a change with the one that belongs to it: symmetric limits of turns stay symmetric."""
    if change.name != "max_vel_theta":
        return (change,)
    values = settings[change.server]
    # DWAPlannerROS has a least turn rate of this name, which is positive.
    lowest_turn = values["min_vel_theta"]
    if lowest_turn != -values["max_vel_theta"]:
        return (change,)
    return change, Change(change.server, "min_vel_theta", lowest_turn, -change.after)


def best_changes(
    replay: Replay, attempts: Sequence[ChangesTogether], cycles: Sequence[ReplayedCycle]
) -> List[Alternative]:
    """Return the best change of each parameter with which the planner drives on faster.

    Changes that bring the robot nearer to obstacles than its inscribed circle are left out.

    Args:
        replay: Replayed drive.
        attempts: Changes to try.
        cycles: Cycles from which the planner drives on.
    """
    if not len(cycles):
        return []
    results_before = drive_on(replay, cycles)
    speeds_before, clearances_before = results_before.T
    # No change may bring the robot nearer to obstacles than it was, or than it fits.
    nearest_before = clearances_before.min(initial=np.inf)
    inscribed_radius = replay.planner.inscribed_radius(cycles[-1].settings)
    nearest = min(nearest_before, inscribed_radius - replay.planner.resolution)
    settings = cycles[0].settings
    by_parameter: Dict[Tuple[str, str], List[Alternative]] = {}
    for attempt in attempts:
        changes = tuple(
            change._replace(before=settings[change.server][change.name]) for change in attempt
        )
        change = changes[0]
        with suppress(ApplrError):  # The value may contradict that of another parameter.
            # Most changes do nothing, which some of the cycles show.
            speeds, _ = drive_on(replay, cycles[::FEW], changes).T
            gain_m_s = (speeds - speeds_before[::FEW]).mean()
            if gain_m_s <= LITTLE:
                _LOGGER.info("%s: left out, %+.2f m/s", change, gain_m_s)
                continue
            results_after = drive_on(replay, cycles, changes)
            _, clearances = results_after.T
            declared = by_name(replay.planner.parameters(change.server))[change.name]
            alternative = Alternative(
                changes,
                declared.default,
                before=MeanResult(*results_before.mean(axis=0).tolist()),
                after=MeanResult(*results_after.mean(axis=0).tolist()),
            )
            clearance_m = clearances.min()
            gain_m_s = alternative.gain
            _LOGGER.info("%s: %+.2f m/s, clearance %.2f m", change, gain_m_s, clearance_m)
            if gain_m_s > LITTLE and clearance_m >= nearest:
                by_parameter.setdefault((change.server, change.name), []).append(alternative)
    return ranked([ranked(alternatives)[0] for alternatives in by_parameter.values()])


def ranked(alternatives: Sequence[Alternative]) -> List[Alternative]:
    """Return alternatives, the best first.

    Among nearly equal ones, changes towards the default come first, of the parameter that is
    farthest from it, and small ones.
    """
    remaining = list(alternatives)
    ranking: List[Alternative] = []
    while remaining:
        largest_gain = max(alternative.gain for alternative in remaining)
        nearly_equal = []
        for alternative in remaining:
            if alternative.gain >= WITHIN * largest_gain:
                nearly_equal.append(alternative)
        best_alternative = min(nearly_equal, key=lambda alternative: alternative.departure)
        ranking.append(best_alternative)
        remaining.remove(best_alternative)
    return ranking
