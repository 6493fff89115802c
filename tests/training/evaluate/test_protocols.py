"""Tests of evaluations beyond the paper's protocol: DynaBARN's moving cylinders, and the BARN
Challenge's rules.

The worlds are synthetic.
"""

import csv
import json
import math
from dataclasses import replace

import numpy as np
import pytest

import worlds
from tests.support.scenes import moving, sdf, write_world
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
    assert evaluate.main(["--out", str(folder), "--trials", "1", "--workers", "0", *arguments]) == 0
    return read_trials(folder / "trials.csv").to_dict("records")


def dynabarn(folder, crossing):
    """Write a DynaBARN-like file: walls, and two cylinders of .5 m with their key frames in a table
    beside the file.

    crossing: Key frames (t [s], x, y [m]) of the first cylinder. The second stays far from the
        course.
    """
    tracks = {"easylibobs_1": crossing, "hardlibobs_2": ((0, -8, 7), (6, 8, 8), (12, -8, 7))}
    with open(folder / NAME, "w", newline="") as file:
        table = csv.writer(file)
        table.writerow(COLUMNS)
        for name, key_frames in tracks.items():
            duration, _, _ = key_frames[-1]
            for key_frame in key_frames:
                table.writerow((name, duration, 1, *key_frame))
    walls = WALL.format(-10.5) + WALL.format(10.5)
    body = walls + "".join(map(moving, tracks))
    return write_world(folder, sdf(body, ""), "world_3.world")


def rates(folder):
    """Return the rows of the report's rates.csv by group of worlds."""
    with open(folder / "report" / "rates.csv") as file:
        return {row["worlds"]: row for row in csv.DictReader(file)}


def gap_to(mover, motion):
    """Return the smallest distance [m] between base_link and the surface of a moving obstacle."""
    gaps = []
    for time, pose in zip(motion.time, motion.pose):
        gaps.append(math.dist(pose[:2], mover.position(time)) - mover.radius)
    return min(gaps)


def test_dynabarn_is_driven(tmp_path):
    """The course of 20 m passes a cylinder that crosses it 7 m ahead of the start, back and
    forth.
    """
    path = dynabarn(tmp_path, ((0, 4, -3), (8, 4, 3), (16, 4, -3)))
    method = tmp_path / "fast.json"
    method.write_text('{"max_vel_x": 1.0, "vx_samples": 12}')
    arguments = ["--worlds", path, "--methods", str(method), "--simulator", "kinematic"]
    out = tmp_path / "out"

    (row,) = drive(out, *arguments, "--no-report")
    assert row["world"] == "world_3"
    assert row["success"], row
    # 20 m, less the goal tolerance, and a detour around the cylinder.
    assert 18.0 < row["path_length_m"] < 26.0
    assert row["time_s"] > 18.0
    motion = read_trace(out, "world_3", "fast", 0).truth
    assert np.allclose(np.abs(motion.pose[0]), [11.0, 0.0, np.pi], atol=0.1)
    crossing, _ = worlds.load(path).movers
    # The cylinder was where its table says: it came near, and was passed.
    assert 0.1 < gap_to(crossing, motion) < 3.0

    # The report does not take it for BARN's world with the same number.
    drive(out, *arguments)
    assert list(rates(out)) == ["Other"]


def test_dynabarn_cylinder_that_runs_into_the_robot(tmp_path):
    """Under the paper's rules the trial goes on, and its row records the contact."""
    world_path = dynabarn(tmp_path, ((0, 11, -4), (2, 11, 3), (30, 11, 3.5)))
    arguments = [
        "--worlds",
        world_path,
        "--methods",
        "dwa",
        "--simulator",
        "kinematic",
        "--no-report",
    ]
    (row,) = drive(tmp_path / "out", *arguments)
    assert row["collided"]
    assert row["decisions"] > 3


def test_the_challenges_rules_apply_and_the_report_has_its_metric(tmp_path):
    """The Challenge's start, goal and limit apply, a collision ends the run, and the report has the
    metric.
    """
    # Given: a world, and the same world with a cylinder that runs into the robot from behind
    bully = worlds.Mover(0.4, ((0.0, -2.25, 0.5), (4.0, -2.25, 6.0), (60.0, -2.25, 6.5)))
    hit_world = replace(worlds.load("generated:2"), name="hit", movers=(bully,))
    sdf_writer.write(hit_world, str(tmp_path / "hit.world"))
    out = tmp_path / "out"

    # When: both are evaluated under the Challenge's rules
    names = f"generated:2,{tmp_path / 'hit.world'}"
    rules = ["--methods", "dwa", "--simulator", "kinematic", "--protocol", "barn-challenge"]
    free, hit = drive(out, "--worlds", names, *rules)

    # Then: the robot drives from the Challenge's start into its goal circle
    assert free["success"]
    assert not free["collided"]
    assert 18.0 < free["time_s"] < 100.0
    motion = read_trace(out, "generated:2", "dwa", 0).truth
    assert np.allclose(motion.pose[0], [-2.25, 3.0, np.pi / 2], atol=0.1)
    assert math.dist(motion.pose[-1][:2], (-2.25, 13.0)) == pytest.approx(1.0, abs=0.1)

    # A collision ends the drive.
    assert hit["collided"]
    assert not hit["success"]
    assert not hit["timeout"]
    assert hit["reason"] == "contact"
    assert hit["time_s"] < 10.0

    # The report has the Challenge's metric: optimal time over time, which counts 2 to 8 of them.
    optimal_s = free["route_m"] / 2
    expected = optimal_s / np.clip(free["time_s"], 2 * optimal_s, 8 * optimal_s)
    groups = rates(out)
    assert float(groups["Training"]["metric"]) == pytest.approx(expected, abs=6e-4)
    assert float(groups["Other"]["metric"]) == 0.0
    settings = json.loads((out / "evaluation.json").read_text())
    assert "barn-challenge" in json.dumps(settings)
