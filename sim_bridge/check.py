"""Checks that a simulator keeps the contract of sim_bridge.Simulator.

Run `python -m sim_bridge.check kinematic`, or `python -m sim_bridge.check my_module:MySimulator` for one of your own.
The tests run it on pybullet and kinematic. Each promise is one function below, whose first line says what is promised.
Everything is driven through the public interface, with a nominal Jackal, and takes a few seconds.
"""

from __future__ import annotations

import argparse
import sys
from functools import partial
from math import cos, hypot, inf, isfinite, nan, pi, sin
from typing import Callable, Iterator, List, Tuple

import numpy as np

from applr_ros1.common.angles import normalize_angle
from applr_ros1.common.errors import run_main
from applr_ros1.robots import geometry
from worlds import Mover, World

from . import NAMES, make
from .scenes import STEP, drive, small_world
from .simulator import RobotState, Simulator, SimulatorError

Factory = Callable[..., Simulator]  # called with keyword arguments of Randomisation, such as slip=0.0


class BrokenPromise(AssertionError):
    """A promise of the contract that a simulator does not keep; one line: what, which value, what it should be."""


def check_simulator(factory: Factory) -> List[str]:
    """Drive simulators from `factory` and compare what they do with the contract.

    Args:
        factory: Makes a simulator; called with keyword arguments of sim_bridge.Randomisation, usually none.

    Returns:
        One line for every promise that is not kept; empty for a simulator that conforms.
    """
    return [line for _, line in _results(factory) if line]


def _results(factory: Factory) -> Iterator[Tuple[str, str]]:
    """(promise, problem or "") one after the other."""
    for promise in PROMISES:
        text = (promise.__doc__ or "").split("\n")[0]
        problem = ""
        try:
            promise(factory)
        except BrokenPromise as error:
            problem = f"{text} But: {error}"
        except Exception as error:  # whatever foreign code raises is a result of the check
            problem = "%s But %s was raised: %s" % (text, type(error).__name__, str(error).split("\n")[0])
        yield text, problem


def _need(condition: bool, text: str, *values: object) -> None:
    if not condition:
        raise BrokenPromise(text % values)


def _numbers(state: RobotState) -> Tuple[float, ...]:
    return (state.time, *state.pose, *state.twist, *state.odom_pose, *state.odom_twist, *state.imu)


def _refuses(what: str, call: Callable[[], object]) -> None:
    try:
        call()
    except SimulatorError as error:
        _need("\n" not in str(error), "the message about %s has several lines", what)
    else:
        raise BrokenPromise(f"{what} is accepted")


# -- the promises ------------------------------------------------------------------------------------------------------
def _starts_standing(factory: Factory) -> None:
    """reset() puts the robot at the start, standing, at time 0, with the odometry's origin there.

    The axes of frame odom stay parallel to the world's.
    """
    simulator = factory()
    _need(isinstance(simulator, Simulator), "%s is no sim_bridge.Simulator", type(simulator).__name__)
    state = simulator.reset(small_world(start=(3.0, -2.0, 2.5)), 0)
    _need(isinstance(state, RobotState), "reset() returned %r, not a RobotState", state)
    _need(state.pose == (3.0, -2.0, 2.5), "it stands at %s, not at (3.0, -2.0, 2.5)", state.pose)
    _need(state.odom_pose == (0.0, 0.0, 2.5), "odom_pose is %s, not (0.0, 0.0, 2.5)", state.odom_pose)
    _need(state.time == 0.0 and state.twist == (0.0, 0.0), "time %g, twist %s", state.time, state.twist)
    _need(not state.contact, "contact is reported in an empty world")
    state = simulator.reset(small_world(), 0, (1.0, 2.0, 0.5))
    _need(state.pose == (1.0, 2.0, 0.5), "reset(start=(1.0, 2.0, 0.5)) puts it at %s", state.pose)
    simulator.close()


def _drives_as_commanded(factory: Factory) -> None:
    """command(v, w) on plain ground drives at v along the robot's x axis and turns left at w, within five percent."""
    simulator = factory(slip=0.0, ground=0.0)
    for v, w in ((0.5, 0.0), (0.0, 1.0), (0.0, -1.0), (0.5, 0.5), (-0.5, 0.0)):
        simulator.reset(small_world(), 0)
        drive(simulator, v, w, 1.0)
        states = [drive(simulator, v, w, STEP) for _ in range(40)]
        _need(all(map(isfinite, _numbers(states[-1]))), "its state is not finite: %s", states[-1])
        driven = np.mean([state.twist for state in states], axis=0)
        for name, asked, got in (("v", v, driven[0]), ("w", w, driven[1])):
            near = abs(got - asked) <= 0.05 * max(abs(asked), 0.2)
            _need(near, "command (%g, %g) is driven at %s = %.3f", v, w, name, got)
    simulator.reset(small_world(start=(0.0, 0.0, 1.0)), 0)
    x, y, _ = drive(simulator, 0.5, 0.0, 2.0).pose
    _need(abs(y * cos(1.0) - x * sin(1.0)) < 0.05 and x > 0.4, "a start at yaw 1 leads to (%.2f, %.2f)", x, y)
    simulator.close()


def _stops_without_commands(factory: Factory) -> None:
    """The base stops its command timeout after the last command, and stands."""
    simulator = factory()
    simulator.reset(small_world(), 1)
    drive(simulator, 0.5, 0.0, 1.0)
    moving = simulator.advance(0.8 * simulator.robot.base.command_timeout).twist[0]
    _need(moving > 0.1, "it drives at %.2f m/s before the time-out", moving)
    stopped = simulator.advance(0.75)
    _need(hypot(*stopped.twist) < 0.01, "it drives at %s one second after the last command", stopped.twist)
    later = simulator.advance(1.0)
    shift = hypot(later.pose[0] - stopped.pose[0], later.pose[1] - stopped.pose[1])
    _need(shift < 2e-3, "it moves by %.4f m while it should stand", shift)
    simulator.close()


def _keeps_time(factory: Factory) -> None:
    """advance() lets that time pass; how a duration is cut into calls does not matter."""
    simulator, poses = factory(), []
    for step in (0.05, 0.1, 0.025):
        simulator.reset(small_world(), 0)
        for _ in range(int(round(1.0 / step))):
            simulator.command(0.7, 0.5)
            state = simulator.advance(step)
        _need(abs(state.time - 1.0) < 0.01, "after steps of %g s that make 1 s the time is %g", step, state.time)
        poses.append(state.pose)
    apart = float(np.abs(np.array(poses) - poses[0]).max())
    _need(apart < 1e-6, "steps of 0.05, 0.1 and 0.025 s end %.2g apart", apart)
    simulator.close()


def _refuses_nonsense(factory: Factory) -> None:
    """A command, start or duration that is not finite, or a duration not above 0, raises SimulatorError of one line."""
    simulator = factory()
    simulator.reset(small_world(), 0)
    _refuses("the command (nan, 0)", lambda: simulator.command(nan, 0.0))
    _refuses("the command (0, inf)", lambda: simulator.command(0.0, inf))
    for duration in (0.0, -1.0, nan):
        _refuses(f"the duration {duration:g}", partial(simulator.advance, duration))
    _refuses("a start at nan", lambda: simulator.reset(small_world(), 0, (0.0, nan, 0.0)))
    _refuses("the randomisation slip=-1", lambda: factory(slip=-1.0))
    simulator.close()


def _sees_what_is_there(factory: Factory) -> None:
    """scan() gives (beams,) float32 ranges from the laser's place: exact but for the noise, +inf for nothing."""
    simulator = factory()
    simulator.reset(small_world([(2.0, 0.0, 0.5), (0.0, 3.0, 0.4)], start=(0.0, 0.0, 0.0)), 0)
    laser = simulator.robot.laser
    scans = np.array([simulator.scan() for _ in range(50)])
    _need(scans.shape == (50, laser.beams), "its shape is %s, not (%d,)", scans.shape[1:], laser.beams)
    _need(scans.dtype == np.float32, "its dtype is %s, not float32", scans.dtype)
    ahead, expected = float(scans[:, laser.beams // 2].mean()), 2.0 - 0.5 - laser.pose[0]
    _need(abs(ahead - expected) < 0.005, "straight ahead it sees %.3f m, not %.3f", ahead, expected)
    side = int(round((pi / 2 - laser.first_angle) / laser.increment))
    left = float(scans[:, side].mean())
    _need(abs(left - 2.6) < 0.05, "to the left it sees %.3f m, not 2.6: angles rise anticlockwise", left)
    _need(bool((scans[:, 0] == inf).all()), "where nothing is it sees %s, not inf", scans[0, 0])
    _need(len(np.unique(scans[:, side])) > 1, "every call gives the same noise")
    _need(float(scans[:, side].std()) < 0.01, "its noise is %.3f m", scans[:, side].std())
    simulator.close()


def _meets_obstacles(factory: Factory) -> None:
    """A wall stops the robot, contact is reported, and the robot can drive back from it."""
    simulator = factory()
    simulator.reset(small_world(boxes=[(1.0, 0.0, 0.0, 0.2, 4.0)]), 0)
    _need(not drive(simulator, 0.5, 0.0, 0.8).contact, "contact is reported before the wall")
    state = drive(simulator, 0.5, 0.0, 2.0)
    front = state.pose[0] + geometry.bounding_box(simulator.robot)[1]
    _need(state.contact, "no contact is reported at a wall that it pushes against")
    _need(abs(front - 0.9) < 0.05, "its front is at x = %.3f where the wall begins at 0.9", front)
    _need(not drive(simulator, -0.5, 0.0, 1.0).contact, "contact stays after driving back from the wall")
    _need(simulator.state.pose[0] < 0.5, "it does not come away from the wall: x = %.2f", simulator.state.pose[0])
    simulator.close()


def _sees_and_meets_movers(factory: Factory) -> None:
    """Moving cylinders are in the scan where they are now, and touch a standing robot."""
    mover = Mover(radius=0.4, waypoints=((0.0, 3.0, 0.0), (6.0, 0.0, 0.0), (12.0, -3.0, 0.0)))
    simulator = factory()
    simulator.reset(small_world(movers=[mover]), 0)
    for _ in range(2):
        x, y, radius = simulator.mover_circles()[0]
        _need(abs(x - mover.position(simulator.state.time)[0]) < 1e-9, "mover_circles() gives x = %.3f", x)
        ahead = float(simulator.scan()[simulator.robot.laser.beams // 2])
        expected = x - radius - simulator.robot.laser.pose[0]
        _need(abs(ahead - expected) < 0.02, "it sees the mover at %.3f m, not %.3f", ahead, expected)
        simulator.advance(1.0)
    touched = [simulator.advance(STEP).contact for _ in range(80)]
    _need(any(touched), "a mover that passes over the robot's place touches nothing")
    simulator.close()


def _believes_its_odometry(factory: Factory) -> None:
    """odom_pose follows the true motion within centimetres a metre; set_odometry() changes what it believes only."""
    simulator = factory()
    simulator.reset(small_world(start=(1.0, 1.0, 0.3)), 0)
    state = drive(simulator, 0.5, 0.1, 4.0)
    x, y, yaw = simulator.to_odom(state.pose)
    apart = hypot(x - state.odom_pose[0], y - state.odom_pose[1])
    _need(apart < 0.1, "after 2 m the odometry is %.2f m off", apart)
    off = normalize_angle(yaw - state.odom_pose[2])
    _need(abs(off) < 0.05, "its heading is off by %.3f rad", off)
    back = simulator.to_world(simulator.to_odom((1.5, -2.0, 3.0)))
    _need(bool(np.allclose(back, (1.5, -2.0, 3.0))), "to_world(to_odom(pose)) is %s, not the pose", back)
    before = state.pose
    simulator.set_odometry((5.0, 6.0, 0.0))
    _need(simulator.state.odom_pose == (5.0, 6.0, 0.0), "set_odometry() leads to %s", simulator.state.odom_pose)
    _need(simulator.state.pose == before, "set_odometry() moved the robot to %s", simulator.state.pose)
    simulator.close()


def _is_teleported(factory: Factory) -> None:
    """teleport() puts the robot elsewhere, standing, while time and the odometry's position go on."""
    simulator = factory()
    simulator.reset(small_world(start=(1.0, 1.0, 0.3)), 0)
    before = drive(simulator, 0.5, 0.1, 2.0)
    after = simulator.teleport((-1.0, 2.0, 1.5))
    _need(after.pose == (-1.0, 2.0, 1.5), "teleport() leads to %s", after.pose)
    _need(after.twist == (0.0, 0.0), "after teleport() it moves at %s", after.twist)
    _need(after.odom_pose == (*before.odom_pose[:2], 1.5), "after teleport() its odometry is %s", after.odom_pose)
    _need(after.time == before.time, "teleport() takes %.3f s", after.time - before.time)
    x, y, _ = simulator.to_world(after.odom_pose)
    _need(hypot(x + 1.0, y - 2.0) < 1e-9, "to_world(odometry) is (%.3f, %.3f) after teleport()", x, y)
    simulator.advance(1.0)
    moved = hypot(simulator.state.pose[0] + 1.0, simulator.state.pose[1] - 2.0)
    _need(moved < 0.2, "it rolls %.2f m on after teleport()", moved)
    state = drive(simulator, 0.5, 0.0, 2.0)
    _need(state.pose[1] > 2.5, "after teleport() and 2 s at .5 m/s it is at y = %.2f", state.pose[1])
    simulator.close()


def _repeats(factory: Factory) -> None:
    """The same world, seed and commands give the same states and scans to the last bit, in another object too."""
    simulator, other = factory(), factory()
    rng = np.random.default_rng(1)
    obstacles = np.column_stack([rng.uniform(0.5, 3.0, 30), rng.uniform(-2.0, 2.0, 30), np.full(30, 0.075)])
    world = small_world(obstacles.tolist())
    first = _trace(simulator, world, 7)
    _trace(simulator, small_world(start=(1.0, 1.0, 1.0)), 8)
    _need(first == _trace(simulator, world, 7), "a second drive with the same seed differs")
    _need(first == _trace(other, world, 7), "another object's drive with the same seed differs")
    _need(first != _trace(simulator, world, 8), "another seed gives the same noise")
    simulator.close()
    other.close()


def _trace(simulator: Simulator, world: World, seed: int) -> List[bytes]:
    rng, rows = np.random.default_rng(9), []
    simulator.reset(world, seed)
    for _ in range(40):
        state = drive(simulator, rng.uniform(-0.5, 1.5), rng.uniform(-2.0, 2.0), 0.1)
        rows.append(np.array(_numbers(state) + (state.contact,)).tobytes() + simulator.scan().tobytes())
    return rows


def _randomises_within_bounds(factory: Factory) -> None:
    """Randomised starts stay within their bounds and follow the seed."""
    simulator = factory(start_xy=0.2, start_yaw=0.3)
    poses = np.array([simulator.reset(small_world(start=(1.0, 2.0, 0.5)), seed).pose for seed in range(20)])
    apart = np.abs(poses - (1.0, 2.0, 0.5)).max(axis=0)
    _need(bool((apart <= (0.2, 0.2, 0.3)).all()), "starts are up to %s away; bounds are 0.2, 0.2, 0.3", apart)
    _need(bool((apart > 0.0).all()), "starts do not differ")
    again = simulator.reset(small_world(start=(1.0, 2.0, 0.5)), 5).pose
    _need(tuple(poses[5]) == again, "seed 5 gives %s, then %s", tuple(poses[5]), again)
    simulator.close()


def _closes(factory: Factory) -> None:
    """close() can be called at any time, also twice."""
    simulator = factory()
    simulator.close()
    simulator.close()


PROMISES: Tuple[Callable[[Factory], None], ...] = (
    _starts_standing,
    _drives_as_commanded,
    _stops_without_commands,
    _keeps_time,
    _refuses_nonsense,
    _sees_what_is_there,
    _meets_obstacles,
    _sees_and_meets_movers,
    _believes_its_odometry,
    _is_teleported,
    _repeats,
    _randomises_within_bounds,
    _closes,
)


def main() -> int:
    """Print a line for every promise. Exit status 1 where one is not kept, or there is no such simulator."""
    parser = argparse.ArgumentParser(prog="python -m sim_bridge.check", description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument(
        "simulator", help=f"Simulator to check: {', '.join(NAMES)}, or my_file.py:Class or module:Class."
    )
    name = parser.parse_args().simulator
    return run_main(lambda: _print_results(name), "check")


def _print_results(name: str) -> int:
    make(name).close()
    broken = 0
    for promise, problem in _results(lambda **options: make(name, **options)):
        broken += bool(problem)
        print(f"FAILED {problem}" if problem else f"ok     {promise}", flush=True)
    print(f"{name} keeps {len(PROMISES) - broken} of {len(PROMISES)} promises")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
