"""compare_simulators: its figures on trials made by hand, and the command from worlds to table, with a toy runner and a
stop in the middle. The real simulators are compared in docs/experiments.md.
"""

import csv
import json
import os
import subprocess
import sys

import numpy as np
import pytest

from applr_ros1.policy import methods
from applr_ros1.policy.parameter_space import SPACE, space_of
from applr_ros1.robots import load
from training import compare_simulators as compare
from training.evaluation.score import FAILURE_SECONDS

HERE = os.path.dirname(os.path.abspath(__file__))
ROOT = os.path.dirname(HERE)


def cells(times, contact=0.0):
    """{(world n, set): one trial}; None: a failure."""
    return {
        ("w%d" % n, "dwa"): np.array([[t is not None, FAILURE_SECONDS if t is None else t, contact]])
        for n, t in enumerate(times)
    }


def test_figures():
    a, b = cells([10, 20, 30, None, 40, None]), cells([12, 22, 32, None, None, 15], contact=1.0)
    figures = compare.agreement(a, b)
    assert figures["cells"] == 6
    assert figures["compared"] == 3
    assert figures["pearson"] == pytest.approx(1.0)
    assert figures["spearman"] == pytest.approx(1.0)
    assert figures["ratio"] == pytest.approx(66 / 60)
    assert figures["same_outcome"] == pytest.approx(4 / 6)
    assert figures["both_failed"] == 1
    assert figures["only_first_failed"] == 1
    assert figures["only_second_failed"] == 1
    assert (figures["contact_first"], figures["contact_second"]) == (0.0, 1.0)
    assert compare.agreement(a, a)["same_outcome"] == 1.0


def test_too_little_to_say_is_said_as_such():
    nothing = compare.agreement(cells([None, None]), cells([5.0, None]))
    assert np.isnan(nothing["pearson"])
    assert np.isnan(nothing["ratio"])
    assert nothing["both_failed"] == 1
    assert "–" in compare.markdown("a", "b", cells([None, None]), cells([5.0, None]))


def test_sets_are_the_same_in_every_run_and_in_range():
    assert compare.set_names(4) == ["dwa", "fast_dwa", "random_1", "random_2"]
    first = compare.Drawn("1").values
    assert np.array_equal(first, compare.Drawn("1").values)
    assert not np.array_equal(first, compare.Drawn("2").values)
    assert np.array_equal(SPACE.clip(first), first)


def test_sets_of_another_robot_are_in_its_ranges():
    robot = load("turtlebot3_waffle_pi")
    assert compare.set_names(3, robot) == ["dwa", "random_1", "random_2"]
    space = space_of(robot)
    drawn = methods.make("training.compare_simulators:Drawn:1", robot)
    assert np.array_equal(space.clip(drawn.theta(None)), drawn.theta(None))
    assert set(drawn.describe()["parameters"]) == {parameter.name for parameter in robot.space}


def run(out, *more):
    command = [
        sys.executable,
        "-m",
        "training.compare_simulators",
        "--worlds",
        "generated:train",
        "--count",
        "4",
        "--sets",
        "3",
        "--trials",
        "2",
        "--runner",
        "toy_runner:ToyRunner",
        "--out",
        str(out),
    ]
    env = dict(os.environ, PYTHONPATH=os.pathsep.join([ROOT, HERE]))
    return subprocess.run(command + list(more), cwd=ROOT, env=env, capture_output=True, text=True, timeout=120)


def test_command(tmp_path):
    """The toy answers by the seed, so both sides are equal: the seeds are the same."""
    done = run(tmp_path)
    assert done.returncode == 0, done.stderr
    rows = list(csv.DictReader((tmp_path / "comparison.csv").read_text().splitlines()))
    assert len(rows) == 4 * 3 * 2
    assert {r["set"] for r in rows} == {"dwa", "fast_dwa", "random_1"}
    assert all(r["time_s_pybullet"] == r["time_s_kinematic"] for r in rows)
    text = (tmp_path / "comparison.md").read_text()
    assert text.startswith("Distance weights: per_cell.\n\n|")
    assert "pybullet against itself" in text
    assert "| same outcome, trial by trial | 1.000 |" in text
    torn = tmp_path / "kinematic" / "trials.csv"
    torn.write_bytes(torn.read_bytes()[:-150])
    assert run(tmp_path).returncode == 0  # what is missing is driven again
    assert (tmp_path / "comparison.md").read_text() == text


def test_another_robot_is_compared(tmp_path):
    done = run(tmp_path, "--robot", "turtlebot3_waffle_pi", "--count", "1", "--trials", "1", "--sets", "2")
    assert done.returncode == 0, done.stderr
    evaluation = json.loads((tmp_path / "kinematic" / "evaluation.json").read_text())
    assert evaluation["robot"]["name"] == "turtlebot3_waffle_pi"
    assert len((tmp_path / "comparison.csv").read_text().splitlines()) == 1 + 2


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (("--simulators", "kinematic"), "two names"),
        (("--sets", "0"), "out of range"),
        (("--worlds", "nowhere.world"), "nowhere.world"),
        (("--cuont", "3"), "--cuont"),
        (("--simulators", "gazebo,kinematic"), "gazebo"),
    ],
)
def test_mistakes_are_one_line(tmp_path, wrong, said):
    done = run(tmp_path, *wrong)
    assert done.returncode == 1, done.stderr
    assert done.stderr.count("\n") == 1, done.stderr
    assert said in done.stderr, done.stderr
