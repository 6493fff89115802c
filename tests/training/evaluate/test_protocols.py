"""Tests of evaluations beyond the paper's protocol: DynaBARN's moving cylinders, and the BARN
Challenge's rules.

The worlds are synthetic.
"""

import csv
import math
from dataclasses import replace

import numpy as np
import pytest

import worlds
from tests.support.scenes import moving, sdf, write_world
from training.env.settings import CHALLENGE, PAPER, under
from training.evaluate import __main__ as evaluate
from training.evaluate.table import read_trace, read_trials
from worlds import sdf_writer
from worlds.dynabarn import COLUMNS, NAME

# Wall along x at a y, 24 m long, as models in DynaBARN's files
WALL = (
    "<model name='wall_{0}'><pose>0 {0} .5 0 0 0</pose><link name='l'><collision "
    "name='c'><geometry><box><size>24 .5 1</size></box></geometry></collision></link></model>"
)


def drive(folder, *arguments):
    """Run an evaluation, and return the rows of its trials.csv as [{column: value}, ...]."""
    options = ["--out", str(folder), "--trials", "1", "--workers", "0"]
    assert evaluate.main([*options, *arguments]) == 0
    table = read_trials(folder / "trials.csv")
    return table.to_dict("records")


def dynabarn(folder, crossing):
    """Write a DynaBARN-like file: walls, and two cylinders of .5 m with their key frames in a table
    beside the file.

    crossing: Key frames (t [s], x, y [m]) of the first cylinder. The second stays far from the
        course.
    """
    far_away = ((0, -8, 7), (6, 8, 8), (12, -8, 7))
    tracks = {"easylibobs_1": crossing, "hardlibobs_2": far_away}
    with open(folder / NAME, "w", newline="") as table_file:
        table = csv.writer(table_file)
        table.writerow(COLUMNS)
        for cylinder_name, key_frames in tracks.items():
            last_key_frame = key_frames[-1]
            duration = last_key_frame[0]
            for key_frame in key_frames:
                table.writerow((cylinder_name, duration, 1, *key_frame))
    walls = WALL.format(-10.5) + WALL.format(10.5)
    body = walls + "".join(map(moving, tracks))
    return write_world(folder, sdf(body, ""), "world_3.world")


def rates(folder):
    """Return the rows of the report's rates.csv by group of worlds."""
    with open(folder / "report" / "rates.csv") as rates_file:
        return {row["worlds"]: row for row in csv.DictReader(rates_file)}


def gap_to(mover, motion):
    """Return the smallest distance [m] between base_link and the surface of a moving obstacle."""
    distances = []
    for time, robot_pose in zip(motion.time, motion.pose):
        distances.append(math.dist(robot_pose[:2], mover.position(time)))
    return min(distances) - mover.radius


def test_dynabarn_is_driven(tmp_path):
    """The course of 20 m passes a cylinder that crosses it 7 m ahead of the start, back and
    forth.
    """
    world_path = dynabarn(tmp_path, ((0, 4, -3), (8, 4, 3), (16, 4, -3)))
    method_file = tmp_path / "fast.json"
    method_file.write_text('{"max_vel_x": 1.0, "vx_samples": 12}')
    arguments = [
        "--worlds",
        world_path,
        "--methods",
        str(method_file),
        "--simulator",
        "kinematic",
    ]
    evaluation = tmp_path / "out"

    (table_row,) = drive(evaluation, *arguments, "--no-report")

    assert table_row["world"] == "world_3"
    assert table_row["success"], table_row
    # 20 m, less the goal tolerance, and a detour around the cylinder.
    assert 18.0 < table_row["path_length_m"] < 26.0
    assert table_row["time_s"] > 18.0
    motion = read_trace(evaluation, "world_3", "fast", 0).truth
    assert np.allclose(np.abs(motion.pose[0]), [11.0, 0.0, np.pi], atol=0.1)
    # The cylinder was where its table says: it came near, and was passed.
    crossing_cylinder, _ = worlds.load(world_path).movers
    assert 0.1 < gap_to(crossing_cylinder, motion) < 3.0

    # The report does not take it for BARN's world with the same number.
    drive(evaluation, *arguments)
    assert list(rates(evaluation)) == ["Other"]


def test_only_barns_worlds_get_the_challenges_course():
    barns_world = worlds.load("generated:7")
    assert under(PAPER, barns_world) is barns_world
    challenge = under(CHALLENGE, barns_world)
    assert challenge.course.start == (-2.25, 3.0, math.pi / 2)
    assert challenge.course.path is barns_world.course.path

    # A field of BARN has a wall on either side.
    x = barns_world.cylinders[:, 0]
    without_right_wall = replace(barns_world, cylinders=barns_world.cylinders[x < -0.1])
    others = [without_right_wall, worlds.load("physical_course"), worlds.load("dynamic:0")]
    for world in others:
        assert under(CHALLENGE, world) is world


def test_the_challenges_rules_apply(tmp_path):
    """The Challenge's start, goal and limit apply, and a collision ends the run."""
    # Given: a world, and the same world with a cylinder that runs into the robot from behind
    key_frames = (
        (0.0, -2.25, 0.5),
        (4.0, -2.25, 6.0),
        (60.0, -2.25, 6.5),
    )
    bully = worlds.Mover(0.4, key_frames)
    hit_world = replace(worlds.load("generated:2"), name="hit", movers=(bully,))
    hit_world_file = str(tmp_path / "hit.world")
    sdf_writer.write(hit_world, hit_world_file)

    # When: both are evaluated under the Challenge's rules
    evaluation = tmp_path / "out"
    free_row, hit_row = drive(
        evaluation,
        "--worlds",
        f"generated:2,{hit_world_file}",
        "--methods",
        "dwa",
        "--simulator",
        "kinematic",
        "--protocol",
        "barn-challenge",
        "--no-report",
    )

    # Then: the robot drives from the Challenge's start into its goal circle
    assert free_row["success"]
    assert not free_row["collided"]
    assert 18.0 < free_row["time_s"] < 100.0
    motion = read_trace(evaluation, "generated:2", "dwa", 0).truth
    assert np.allclose(motion.pose[0], [-2.25, 3.0, np.pi / 2], atol=0.1)
    last_position = motion.pose[-1][:2]
    assert math.dist(last_position, (-2.25, 13.0)) == pytest.approx(1.0, abs=0.1)

    # A collision ends the drive.
    assert hit_row["collided"]
    assert not hit_row["success"]
    assert not hit_row["timeout"]
    assert hit_row["reason"] == "contact"
    assert hit_row["time_s"] < 10.0
