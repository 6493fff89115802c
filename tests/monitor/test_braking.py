"""Tests of changes of direction: which commands of a slow base pass at once, and what is said."""

import math

import pytest

from applr_ros1.monitor.monitor import (
    BRAKE,
    BRAKING,
    PASS,
    REVERSING,
    SLOW,
    STOP,
    CollisionMonitor,
    MonitorOutput,
    Verdict,
)
from applr_ros1.monitor.motion import PoseVelocity
from tests.monitor.scenes import BEHIND, HERE, SETTINGS, across, scan_of, wall

CYCLE_S = 0.05  # time between two commands [s]
DRIVEN_CYCLES = 12  # cycles before the change of direction
SPEED = 0.3  # m/s: at most so fast, wheels lock when they are slowed down hard
BACK = (-0.5, 0.0)
# Posts of 5 cm radius, 0.2 m behind the outline where the robot changes its direction
POSTS_BEHIND = across(-0.3, -0.3, 0.31, 0.05)


def reversal(
    speed=SPEED,
    turn=0.0,
    wheel_speed=None,
    command=BACK,
    posts=(),
    cycle_s=CYCLE_S,
    last_command=None,
):
    """Return the verdicts on a command that follows 12 cycles of driving.

    Args:
        speed: Speed of the poses [m/s].
        turn: Commanded and measured turn rate [rad/s].
        wheel_speed: Speed of the odometry [m/s]; None for that of the poses.
        command: Command (v, w) of the cycles from then on.
        posts: Posts (n, 2) [m].
        cycle_s: Time between two commands [s].
        last_command: Speed commanded in the last cycle of driving [m/s]; None for that of the
            poses.
    """
    if wheel_speed is None:
        wheel_speed = speed
    commands = [speed] * DRIVEN_CYCLES
    if last_command is not None:
        commands[-1] = last_command
    monitor = CollisionMonitor()
    monitor.add_scan(scan_of(posts, BEHIND, -0.1))
    # All space is observed.
    monitor.seen.cells[:] = 1
    x, y, yaw = 0.0, 0.0, 0.0
    for cycle in range(DRIVEN_CYCLES):
        time = cycle * cycle_s
        monitor.add_scan(scan_of(posts, (x, y, yaw), time))
        monitor.filter(time, (x, y, yaw), (wheel_speed, turn), (commands[cycle], turn))
        x += speed * math.cos(yaw) * cycle_s
        y += speed * math.sin(yaw) * cycle_s
        yaw += turn * cycle_s

    # The base does at once what it is told, from the wheels' speed on.
    verdicts = []
    for cycle in range(DRIVEN_CYCLES, DRIVEN_CYCLES + 20):
        time = cycle * cycle_s
        monitor.add_scan(scan_of(posts, (x, y, yaw), time))
        verdict = monitor.filter(time, (x, y, yaw), (wheel_speed, turn), command)
        verdicts.append(verdict)
        wheel_speed, turn = verdict.command
        x += wheel_speed * cycle_s
    return verdicts


def test_a_free_slow_base_that_drives_straight_on_reverses_at_once():
    for speed in (0.1, SPEED):
        verdicts = reversal(speed)
        assert verdicts[0] == Verdict(BACK), speed
        assert verdicts[0].action == PASS
    # Back and ahead are alike.
    ahead = reversal(-SPEED, command=(0.5, 0.0))
    assert ahead[0] == Verdict((0.5, 0.0))


def test_a_faster_base_brakes_down_to_the_slow_speed_first():
    """1.9 m/s^2 take 0.095 m/s off in each cycle."""
    verdicts = reversal(0.65)
    speeds = [verdict.command[0] for verdict in verdicts[:5]]
    assert speeds == pytest.approx([0.555, 0.46, 0.365, 0.27, -0.5])


@pytest.mark.parametrize(
    "scene",
    [
        # The wheels are to turn.
        {"command": (-0.5, 0.3)},
        # An obstacle limits the command.
        {"posts": POSTS_BEHIND},
        # The base stops, or only slows down.
        {"command": (0.0, 0.0)},
        {"command": (0.1, 0.0)},
    ],
    ids=["is to turn", "behind", "stops", "slows down"],
)
def test_every_other_slow_base_is_braked_gently(scene):
    verdict = reversal(**scene)[0]
    assert verdict.command[0] == pytest.approx(SPEED - 0.6 * CYCLE_S)


def test_a_base_whose_slide_is_unknown_is_braked_gently():
    """The poses of a planner at less than 4 Hz are too far apart for a velocity."""
    verdict = reversal(cycle_s=0.3)[0]
    assert (verdict.action, verdict.reason) == (BRAKE, REVERSING)
    assert verdict.command[0] == pytest.approx(SPEED - 0.6 * 0.3)


@pytest.mark.parametrize(
    ("measured", "reverses"),
    [
        ({}, True),
        ({"commanded_w": 0.2}, False),
        ({"wheel_w": -0.2}, False),
        # The limits are 0.15 rad/s and 0.05 m/s.
        ({"pose_w": 0.14}, True),
        ({"pose_w": 0.16}, False),
        ({"pose_w": -0.16}, False),
        ({"slide": 0.04}, True),
        ({"slide": 0.06}, False),
        ({"slide": -0.06}, False),
        ({"sideways": 0.04}, True),
        ({"sideways": 0.06}, False),
        ({"sideways": -0.06}, False),
    ],
    ids=str,
)
def test_a_base_that_turns_or_slides_by_any_measure_does_not_reverse_at_once(measured, reverses):
    # Given: a base in free space, whose poses show a turn about the centre of rotation
    motion = {"commanded_w": 0.0, "wheel_w": 0.0, "pose_w": 0.0, "slide": 0.0, "sideways": 0.0}
    motion.update(measured)
    monitor = CollisionMonitor()
    monitor.add_scan(scan_of((), BEHIND, -0.1))
    monitor.seen.cells[:] = 1
    monitor.add_scan(scan_of((), HERE, 0.0))
    leftward = motion["sideways"] - SETTINGS.turn_ahead * motion["pose_w"]
    monitor.motion.take = lambda stamp, pose, v: None
    monitor.motion.velocity = PoseVelocity(SPEED, motion["pose_w"], leftward)
    monitor.motion.baseline = 0.25
    monitor.motion.slide = motion["slide"]
    monitor.output = MonitorOutput(-CYCLE_S, SPEED, motion["commanded_w"])

    # Then: it only reverses at once if none of them shows a turn or a slide
    verdict = monitor.filter(0.0, HERE, (SPEED, motion["wheel_w"]), BACK)
    expected = BACK[0] if reverses else SPEED - 0.6 * CYCLE_S
    assert verdict.command[0] == pytest.approx(expected)


@pytest.mark.parametrize("changes", [{"last_command": 1.0}, {"wheel_speed": 0.31}])
def test_a_base_faster_than_commanded_or_measured_does_not_reverse_at_once(changes):
    """It may still be speeding up, or roll faster than it was told."""
    verdict = reversal(0.28, **changes)[0]
    assert (verdict.action, verdict.reason) == (BRAKE, REVERSING)
    assert verdict.command[0] == pytest.approx(0.28 - 0.6 * CYCLE_S)


def test_an_action_that_changes_a_command_is_not_pass():
    reversing = reversal(turn=0.3, command=(-0.5, 0.3))[0]
    assert (reversing.action, reversing.reason, reversing.scale) == (BRAKE, REVERSING, 1.0)
    stopping = reversal(command=(0.0, 0.0))[0]
    assert (stopping.action, stopping.reason) == (BRAKE, BRAKING)
    for verdict in reversal(0.65):
        is_changed = verdict.command != BACK
        assert verdict.action == (BRAKE if is_changed else PASS)

    # A limited command keeps its reason.
    limited = reversal(posts=wall(1.2), speed=1.0, command=(2.0, 0.0))[0]
    assert limited.action in (SLOW, STOP)
    assert "obstacle" in limited.reason


def test_a_base_that_brakes_because_the_planner_stops_is_not_blocked():
    for verdict in reversal(command=(0.0, 0.0)):
        assert not verdict.blocked
