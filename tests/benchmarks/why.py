"""Figures of `./applr why` for docs/explanation/results.md: `python -m tests.benchmarks.why [BAG ...]`.

With bags of the Jackal, print the share of their commands that the replay reproduces. Without, spoil one parameter at a
time in simulation, and print the rank of this parameter, or of its equal, among the alternatives of each drive that the
fault makes fail or 1.5 times as long, and the rows of docs/results/planted.csv. It takes an hour on two cores.
"""

import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from time import process_time

from applr_ros1.robots import JACKAL, load
from tests.support.drives import changed, simulated
from training.why import __main__ as why
from training.why.diagnosis import diagnose
from training.why.replay import Replay

SLOWER, LIMIT_S = 1.5, 60.0
WORLDS = {
    "3, 11, 40, 7": (3, 11, 40, 7),
    "5, 17, 23, 28": (5, 17, 23, 28),
}  # the rules were chosen on the first ones
TRAJECTORY, DWA = "TrajectoryPlannerROS", "DWAPlannerROS"
LAYERS = {TRAJECTORY: "/inflater_layer", DWA: ""}  # where the files have the inflation
EQUAL = {  # equals on the page of the C++ planner
    "inflation_radius": ("occdist_scale", "cost_scaling_factor"),
    "cost_scaling_factor": ("occdist_scale", "inflation_radius"),
    "occdist_scale": ("inflation_radius", "cost_scaling_factor"),
}
TUNED = dict(
    max_vel_x=1.341, max_vel_theta=2.303, min_vel_theta=-2.303, vx_samples=16, vtheta_samples=56, sim_time=1.113,
    occdist_scale=0.401, path_distance_bias=0.466, goal_distance_bias=1.496, min_in_place_vel_theta=0.75,
)  # fmt: skip
ROBOTS = {
    "Jackal, defaults": JACKAL,
    "Jackal, tuned set": changed(
        JACKAL, {TRAJECTORY: TUNED, "local_costmap": {"footprint_padding": 0.14}}
    ),
    "waffle_pi": load("turtlebot3_waffle_pi"),
}
FAULTS = {
    TRAJECTORY: [
        dict(sim_time=4.0), dict(sim_time=0.3), dict(occdist_scale=0.8), dict(path_distance_bias=5.0),
        dict(goal_distance_bias=0.1), dict(inflation_radius=0.8), dict(cost_scaling_factor=1.0), dict(vx_samples=1),
        dict(vtheta_samples=2), dict(max_vel_theta=0.3, min_vel_theta=-0.3), dict(acc_lim_theta=0.5),
        dict(acc_lim_x=0.1), dict(oscillation_reset_dist=2.0), dict(heading_lookahead=2.0),
    ],
    DWA: [
        dict(sim_time=5.0), dict(sim_time=0.4), dict(occdist_scale=1.0), dict(path_distance_bias=400.0),
        dict(goal_distance_bias=1.0), dict(inflation_radius=2.0), dict(cost_scaling_factor=0.5), dict(vx_samples=2),
        dict(vth_samples=2), dict(max_vel_theta=0.3, min_vel_theta=0.1), dict(acc_lim_theta=0.3),
        dict(acc_lim_x=0.1), dict(oscillation_reset_dist=1.0), dict(forward_point_distance=1.2),
        dict(scaling_speed=0.01, max_scaling_factor=3.0), dict(twirling_scale=20.0),
    ],
}  # fmt: skip


def spoilt(robot, fault):
    """Return the robot with a fault {parameter: value} in its files."""
    if not {"inflation_radius", "cost_scaling_factor"} & {*fault}:
        return changed(robot, {robot.local_planner: fault})
    return changed(
        robot,
        {f"{name}_costmap{LAYERS[robot.local_planner]}": fault for name in ("local", "global")},
    )


def planted(name, world):
    """Return (fault, rank, number of remedies) of the sound drive through a world and of those that it slows."""
    robot, usual, found = ROBOTS[name], LIMIT_S, []
    for fault in [{}, *FAULTS[robot.local_planner]]:
        driven = spoilt(robot, fault) if fault else robot
        recorded, outcome = simulated(
            driven, f"generated:{world}", limit=max(40.0, min(90.0, 3.0 * usual))
        )
        if not (fault or outcome.success):
            return []
        if fault and outcome.success and outcome.time_s < SLOWER * usual:
            continue
        usual = usual if fault else outcome.time_s
        replay = Replay(driven)
        replay.run(recorded)
        diagnosis = diagnose(replay)
        names = [one.parameter.name for one in diagnosis.tried]
        ranks = [
            names.index(one) + 1
            for one in {*fault, *(other for one in fault for other in EQUAL.get(one, ()))}
            & {*names}
        ]
        found.append((fault, min(ranks, default=99), len(diagnosis.remedies)))
        end = f"{outcome.reason} {outcome.time_s:.1f} s, rank {found[-1][1]} of {names[:3]}"
        print(
            f"{name}, world {world}, {fault or 'sound'}: {end}, {found[-1][2]} remedies", flush=True
        )
    return found


def reproduced(path):
    """Print the share of a bag's commands that the replay reproduces."""
    began, replay = process_time(), Replay(JACKAL)
    replay.run(why.drive_of(Path(path), why.WhyOptions(bag=[path], robot=JACKAL)))
    near = sum(cycle.error < 0.1 for cycle in replay.cycles) / len(replay.cycles)
    print(f"{path}: {len(replay.cycles)} cycles, {replay.share:.1%} to 1e-6, {near:.1%} within 0.1, "
          f"{process_time() - began:.1f} s of one core")  # fmt: skip


def all_planted():
    """Print the ranks of all planted faults, and the rows of docs/results/planted.csv."""
    with ProcessPoolExecutor(2) as pool:
        jobs = {
            (n, group): [pool.submit(planted, n, w) for w in worlds]
            for group, worlds in WORLDS.items()
            for n in ROBOTS
        }
        done = {key: [row for job in made for row in job.result()] for key, made in jobs.items()}
    print(
        "robot,worlds,drives,parameters,first,among the first three,sound drives,of these with a remedy"
    )
    for (name, worlds), rows in done.items():
        ranks = [(next(iter(fault)), rank) for fault, rank, _ in rows if fault]
        sound = [remedies for fault, _, remedies in rows if not fault]
        counts = (
            len(ranks),
            len({one for one, _ in ranks}),
            sum(r == 1 for _, r in ranks),
            sum(r <= 3 for _, r in ranks),
        )
        print(
            f'"{name}","{worlds}",{",".join(map(str, counts))},{len(sound)},{sum(n > 0 for n in sound)}'
        )


if __name__ == "__main__":
    for bag in sys.argv[1:]:
        reproduced(bag)
    if len(sys.argv) == 1:
        all_planted()
