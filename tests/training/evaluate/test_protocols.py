"""Tests of evaluations beyond the paper's protocol: DynaBARN's moving cylinders, and the BARN
Challenge's rules.

The worlds are synthetic.
"""

import csv
import json

import numpy as np
import pytest

import worlds
from tests.support.scenes import moving, sdf, write_world
from training.evaluate import __main__ as evaluate
from training.evaluate.table import read_trace, read_trials
from worlds import sdf_writer
from worlds.dynabarn import COLUMNS, NAME

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
    body = "".join(WALL.format(y) for y in (-10.5, 10.5))
    body += "".join(map(moving, tracks))
    rows = [(name, frames[-1][0], 1, *frame) for name, frames in tracks.items() for frame in frames]
    (folder / NAME).write_text("\n".join(",".join(map(str, row)) for row in [COLUMNS, *rows]))
    return write_world(folder, sdf(body, ""), "world_3.world")


def test_dynabarn_is_driven(tmp_path):
    """The course of 20 m passes a cylinder that crosses it 7 m ahead of the start, back and
    forth.
    """
    path = dynabarn(tmp_path, ((0, 4, -3), (8, 4, 3), (16, 4, -3)))
    (tmp_path / "fast.json").write_text('{"max_vel_x": 1.0, "vx_samples": 12}')
    given = "--worlds", path, "--methods", str(tmp_path / "fast.json"), "--simulator", "kinematic"
    rows = drive(tmp_path / "out", *given, "--no-report")
    assert [r["world"] for r in rows] == ["world_3"]
    assert rows[0]["success"], rows
    assert 18.0 < rows[0]["path_length_m"] < 26.0
    assert rows[0]["time_s"] > 18.0
    motion = read_trace(tmp_path / "out", "world_3", "fast", 0).truth
    assert np.allclose(np.abs(motion.pose[0]), [11.0, 0.0, np.pi], atol=0.1)
    mover = worlds.load(path).movers[0]
    gap = [
        np.hypot(*(pose[:2] - mover.position(t))) - mover.radius
        for t, pose in zip(motion.time, motion.pose)
    ]
    assert 0.1 < min(gap) < 3.0
    drive(tmp_path / "out", *given)
    with open(tmp_path / "out" / "report" / "rates.csv") as file:
        # Not BARN's group by the number.
        assert {row["worlds"] for row in csv.DictReader(file)} == {"Other"}


def test_dynabarn_cylinder_that_runs_into_the_robot(tmp_path):
    """Under the paper's rules the trial goes on, and its row records the contact."""
    path = dynabarn(tmp_path, ((0, 11, -4), (2, 11, 3), (30, 11, 3.5)))
    (row,) = drive(
        tmp_path / "out",
        "--worlds",
        path,
        "--methods",
        "dwa",
        "--simulator",
        "kinematic",
        "--no-report",
    )
    assert row["collided"]
    assert row["decisions"] > 3


def test_the_challenges_rules_apply_and_the_report_has_its_metric(tmp_path):
    """The Challenge's start, goal and limit apply, a collision ends the run, and the report has the
    metric.
    """
    base = worlds.load("generated:2")
    # From behind, faster.
    bully = worlds.Mover(0.4, ((0.0, -2.25, 0.5), (4.0, -2.25, 6.0), (60.0, -2.25, 6.5)))
    world = worlds.World("hit", base.cylinders, base.boxes, base.course, (bully,))
    sdf_writer.write(world, str(tmp_path / "hit.world"))
    given = "--methods", "dwa", "--simulator", "kinematic", "--protocol", "barn-challenge"
    rows = drive(tmp_path / "out", "--worlds", "generated:2,%s" % (tmp_path / "hit.world"), *given)
    free, hit = rows
    assert free["success"]
    assert not free["collided"]
    assert 18.0 < free["time_s"] < 100.0
    driven = read_trace(tmp_path / "out", "generated:2", "dwa", 0).truth
    assert np.allclose(driven.pose[0], [-2.25, 3.0, np.pi / 2], atol=0.1)
    assert abs(np.hypot(*(driven.pose[-1][:2] - (-2.25, 13.0))) - 1.0) < 0.1
    assert hit["collided"]
    assert not hit["success"]
    assert not hit["timeout"]
    assert hit["reason"] == "contact"
    assert hit["time_s"] < 10.0
    with open(tmp_path / "out" / "report" / "rates.csv") as file:
        table = {row["worlds"]: row for row in csv.DictReader(file)}
    route = free["route_m"]
    time = free["time_s"]
    expected = route / 2 / np.clip(time, route, 8 * route / 2)
    assert float(table["Training"]["metric"]) == pytest.approx(expected, abs=6e-4)
    assert float(table["Other"]["metric"]) == 0.0
    settings = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert "barn-challenge" in json.dumps(settings)
