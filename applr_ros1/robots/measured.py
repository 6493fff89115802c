"""Measures of a robot from its drives: how its base follows commands, brakes and turns, and what its scanner states.

measure_braking.py drives for it, training/bags/drive.py reads it from bags; owner/write.py writes it into robot.yaml.
"""

from __future__ import annotations

import itertools
import math
from typing import Any, Dict, List, NamedTuple, Optional, Tuple

import numpy as np
import scipy

from applr_ros1.common.angles import normalize_angle
from applr_ros1.common.errors import ApplrError

STANDING = 0.3  # s over which a speed is averaged before braking, and without motion that count as standing
STILL = 0.02, 0.05  # m/s, rad/s: less is no motion
FELL = 0.9  # of its speed: when it is slower, the base has begun to brake
STEP = 0.01  # [s] of the grid on which a response is fitted
DELAYS, LAGS = np.arange(0.0, 0.4, STEP), (0.0, 0.01, 0.02, 0.03, 0.05, 0.08, 0.12, 0.2)  # [s]
LIMITS = (math.inf, 5.0, 3.5, 2.5, 1.8, 1.3, 1.0, 0.7, 0.5, 0.35, 0.25)  # [m/s^2]
CLEARLY = 0.8  # of the error without a limit that one with it may leave
HELD, WITHIN = 0.25, 0.3  # s for which a command has to stay within this share to show what the base makes of it
PARTS, PART = 3, 3.0  # of a drive, for the spread, and their least length [s]
LEAST = 0.3  # rad/s or m/s; slower commands show mostly friction


class Reading(NamedTuple):
    """A message of the odometry: stamp [s], pose, and twist ahead and about z."""

    time: float
    x: float
    y: float
    yaw: float
    v: float
    w: float


class Stop(NamedTuple):
    """Stop of a base: speed [m/s or rad/s], the same over the commanded one, time until it slowed down [s], way."""

    speed: float
    gain: float
    reaction: float
    way: float


class Value(NamedTuple):
    """A measured value of a field of robot.yaml with its unit, the spread between drives or parts of them, and how."""

    value: float
    unit: str
    spread: float
    how: str

    def __str__(self) -> str:
        return f"{self.value:.3g} {self.unit}".rstrip() + f" +- {self.spread:.2g} ({self.how})"

    def contradicts(self, given: Optional[float]) -> bool:
        """Tell whether a given value is none, or more than twice the spread away."""
        return given is None or abs(given - self.value) > 2.0 * self.spread


Fields = Dict[Tuple[str, str], Value]  # by section and field
FOLLOWS = "simulation.command_delay", "odometry.lag", "base.max_acceleration", "monitor.deceleration"  # a Response


def stop_of(samples: List[Reading], braked: float, command: float, turning: bool) -> Stop:
    """Return how a base stopped from `command` [m/s, rad/s if turning], commanded to stop at the time `braked` [s]."""
    motion = [abs(s.w if turning else s.v) for s in samples]
    before = [m for m, s in zip(motion, samples) if braked - STANDING < s.time <= braked]
    after = [(m, s) for m, s in zip(motion, samples) if s.time >= braked]
    if not before or len(after) < 2:
        raise ApplrError("hardly any odometry came while the robot drove: is its clock that of this machine?")
    speed = sum(before) / len(before)
    reaction = next((s.time for m, s in after if m < FELL * speed), after[-1][1].time) - braked
    steps = [(b.x - a.x, b.y - a.y, normalize_angle(b.yaw - a.yaw)) for (_, a), (_, b) in zip(after, after[1:])]
    return Stop(
        speed, speed / abs(command), reaction, sum(abs(c) if turning else math.hypot(a, b) for a, b, c in steps)
    )


def deceleration(stops: List[Stop], reaction: float) -> float:
    """The least a with which every way is at most speed * reaction + speed^2 / (2 a)."""
    return min(s.speed**2 / (2.0 * max(s.way - s.speed * reaction, 1e-3)) for s in stops)


def reaction(straight: List[Stop], turns: List[Stop]) -> float:
    """Return a time [s] until the base brakes, from the median of its stops up.

    It is the one of a stop with which `deceleration` of the straight ones lets the fastest come to rest soonest: one
    stop that began late, as on a busy machine, then does not count as weak brakes.
    """
    times = sorted(s.reaction for s in straight + turns)
    top = max(s.speed for s in straight)

    def way(time: float) -> float:
        return round(top * time + top**2 / (2.0 * deceleration(straight, time)), 3)

    return min(times[len(times) // 2 :], key=way)


class Response(NamedTuple):
    """Way in which speeds follow commands: rms error [m/s], delay and time constant [s], limits up and down [m/s^2]."""

    error: float
    delay: float
    lag: float
    faster: float
    slower: float


def response(time: np.ndarray, command: np.ndarray, at: np.ndarray, speed: np.ndarray) -> Response:
    """The delay, first-order lag and limits with which commands come nearest to the speeds that were driven.

    Args:
        time: (n,) of the commands [s], rising.
        command: (n,) [m/s].
        at: (m,) of the odometry [s], rising.
        speed: (m,) [m/s].
    """
    grid = np.arange(max(time[0], at[0]), min(time[-1], at[-1]), STEP)
    if len(grid) < 2.0 / STEP:
        raise ApplrError("commands and odometry have less than two seconds in common")
    told, driven = _told(time, command, grid), np.interp(grid, at, speed)
    free, *limited = (_fits(told, driven, up, down) for up, down in itertools.product(LIMITS, LIMITS))
    best = min(limited)
    return best if best.error < CLEARLY * free.error else free


def _fits(told, driven, faster, slower):
    """The Response of the delay and lag that fit best with these limits."""
    limited, skipped, found = _limited(told, driven[0], faster, slower) - driven[0], len(DELAYS), []
    for lag in LAGS:
        keep = math.exp(-STEP / lag) if lag else 0.0
        follows = scipy.signal.lfilter([1.0 - keep], [1.0, -keep], limited) + driven[0]
        for n, delay in enumerate(DELAYS):
            off = follows[skipped - n : len(follows) - n] - driven[skipped:]
            found.append(Response(float(np.sqrt(np.mean(off * off))), float(delay), lag, faster, slower))
    return min(found)


def _limited(told, now, faster, slower):
    """Commands (n,), followed from a speed now with a magnitude that rises and falls no faster than this [m/s^2]."""
    if math.isinf(faster) and math.isinf(slower):
        return told
    limited = np.empty(len(told))
    for i, wanted in enumerate(told.tolist()):
        limit = STEP * (faster if abs(wanted) > abs(now) and wanted * now >= 0.0 else slower)
        now += min(max(wanted - now, -limit), limit)
        limited[i] = now
    return limited


def _told(time, command, at):
    """The command in force (m,) at each time."""
    return command[np.maximum(np.searchsorted(time, at, side="right") - 1, 0)]


def followed(time: np.ndarray, command: np.ndarray, at: np.ndarray, speed: np.ndarray, late: float) -> np.ndarray:
    """(k, 2): the command, and the speed over it, at each time (m,) at which a command had stayed nearly the same.

    late: of the speeds behind the commands [s].
    """
    told = np.array([_told(time, command, at - late - back) for back in np.linspace(0.0, HELD, 6)])
    middle = told.mean(axis=0)
    steady = (
        (np.abs(middle) >= LEAST) & (np.ptp(told, axis=0) <= WITHIN * np.abs(middle)) & (at - late - HELD > time[0])
    )
    return np.column_stack([told[0, steady], speed[steady] / told[0, steady]])


def base(time: np.ndarray, command: np.ndarray, at: np.ndarray, twist: np.ndarray, some: int) -> Fields:
    """Return what a drive says of a base, where it does.

    Args:
        time: (n,) of the commands [s], rising.
        command: (n, 2) [m/s, rad/s].
        at: (m,) of the odometry [s], rising.
        twist: (m, 2) [m/s, rad/s].
        some: samples that a value needs.
    """
    how, found = response(time, command[:, 0], at, twist[:, 0]), {}
    parts = [part for part in np.array_split(np.arange(len(time)), PARTS) if np.ptp(command[part, 0]) >= LEAST]
    each = [response(time[p], command[p, 0], at, twist[:, 0]) for p in parts if np.ptp(time[p]) > PART]
    for n, place in enumerate(FOLLOWS):
        if math.isfinite(how[n + 1]):
            section, name = place.split(".")
            off = [abs(one[n + 1] - how[n + 1]) for one in each if math.isfinite(one[n + 1])]
            spread = max(STEP if n < 2 else 0.0, 1.4826 * float(np.median(off or [0.0])))
            found[section, name] = Value(how[n + 1], "s" if n < 2 else "m/s^2", spread, f"{len(time)} commands")
    for column, name, unit in ((0, "max_speed", "m/s"), (1, "max_yaw_rate", "rad/s")):
        follows = followed(time, command[:, column], at, twist[:, column], how.delay + how.lag)
        fast = np.abs(follows[:, 0]) > 0.9 * np.max(np.abs(follows[:, 0]), initial=0.0)
        if column and len(follows) >= some:
            found["monitor", "turn_gain"] = middle(np.clip(follows[:, 1], 0.5, 3.0), "", "moments of steady turns")
        elif fast.sum() >= some and np.median(follows[fast, 1]) < FELL:
            driven = np.abs(follows[fast].prod(axis=1))
            found["base", name] = middle(driven, unit, "moments in which it was told more")
    return found


def middle(values: Any, unit: str, what: str) -> Value:
    """The median of values, with the standard deviation that their quartiles have of a normal distribution."""
    quartiles = np.percentile(values, (25, 50, 75))
    return Value(float(quartiles[1]), unit, float(quartiles[2] - quartiles[0]) / 1.35, f"{len(values)} {what}")


def combined(values: List[Value]) -> Value:
    """One value of those of several drives: their median, with the larger of their spread and that within them."""
    numbers = [value.value for value in values]
    spread = max(float(np.std(numbers)), float(np.median([value.spread for value in values])))
    how = values[0].how if len(values) == 1 else f"{len(values)} drives; {values[0].how}"
    return Value(float(np.median(numbers)), values[0].unit, spread, how)
