"""./applr try: the verdict by made-up results, when it ends, reasons of failures, the command with a toy."""

import shutil
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from applr_ros1 import robots
from applr_ros1.policy import methods
from tests.support import HANGS, ROOT
from training import try_robot
from training.evaluation.plan import Trial, TrialResult
from training.evaluation.trials import content
from training.report import verdict as judging
from training.report.verdict import decided, mean_scores, paired_trials

ROBOT = "mine", "/home/me/mine", False
BOTH, THREE = ("dwa", "applr"), ("dwa", "applr", "static")


def trials_of(world, seconds, trial=0):
    """{Trial: TrialResult} of one course; seconds: {method: time [s], or the reason of a failure}."""
    found = {}
    for method, value in seconds.items():
        failed = isinstance(value, str)
        result = TrialResult(success=not failed, timeout=failed, time_s=100.0 if failed else value)
        result = TrialResult(**{**vars(result), "reason": value if failed else "finished"})
        found[Trial(world, method, trial, 1, world, method, "ours")] = result
    return found


def pairs_of(*courses, methods=BOTH):
    found = {}
    for number, values in enumerate(courses):
        found.update(trials_of(f"world{number}", dict(zip(methods, values))))
    return paired_trials(found, methods)


def around(*middles, count=12):
    draws = np.random.default_rng(1).normal(0.0, 1.0, (count, len(middles)))
    return [tuple(map(float, np.array(middles) + draw)) for draw in draws - draws.mean(axis=0)]


@pytest.mark.parametrize(
    ("courses", "methods", "method", "second", "third"),
    [
        (around(30, 20), BOTH, "applr", "The policy pays on mine: it takes 10.0 s less", "Drive with it"),
        (around(20, 30), BOTH, "dwa", "does not pay on mine: it takes 10.0 s more", "Keep your parameters, or"),
        (around(20, 20), BOTH, "dwa", "Whether the policy pays on mine is not clear", "more --minutes"),
        (around(30, 25, 15), THREE, "static", "the tuned parameters do", "tuned.yaml"),
        (around(30, 15, 25), THREE, "applr", "The policy pays", "Drive with it"),
    ],
)
def test_the_verdict_is_three_sentences_and_a_method(courses, methods, method, second, third):
    found, sentences = judging.verdict(pairs_of(*courses, methods=methods), *ROBOT)
    assert found == method
    assert sentences[0].startswith("Of 12 courses mine finished 12 (100 %, 76 to 100 %) in ")
    assert second in sentences[1]
    assert third in sentences[2]


def test_where_most_courses_fail_with_all_the_first_sentence_says_so():
    mostly = [("time limit", "time limit")] * 6 + [(20.0, 20.0)] * 5
    _, sentences = judging.verdict(pairs_of(*mostly), *ROBOT)
    assert sentences[0].startswith("mine fails in most courses, whatever sets its parameters: of 11 courses")
    _, sentences = judging.verdict(pairs_of(*mostly, (20.0, 20.0)), *ROBOT)
    assert sentences[0].startswith("Of 12 courses")


def test_a_robot_that_open_floor_stops_gets_no_verdict(tmp_path, capsys):
    """The Husky's own parameters keep it from a door that is .3 m wider than itself."""
    words = ["husky", "--workers", "0", "--out", str(tmp_path / "out"), "--runner", f"{__name__}:fixed"]
    assert try_robot.main(words) == 1
    printed = capsys.readouterr().out.splitlines()
    assert printed[0].startswith(
        "The set-up of husky is wrong. On open floor, with its own parameters, it cannot drive t"
    )
    assert printed[1].startswith("It can drive straight on (")
    assert printed[2] == "Give occdist_scale 0.005 instead of 0.01: all four drives arrive with it."
    assert len(printed) == 4
    assert not (tmp_path / "out").exists()


def test_a_policy_that_is_faster_but_fails_more_often_does_not_pay():
    courses = [*around(30, 25, count=9), *[(30.0 + i, "time limit") for i in range(7)]]
    method, sentences = judging.verdict(pairs_of(*courses), *ROBOT)
    assert method == "dwa"
    assert "16 (100 %" in sentences[0]
    assert "9 (56 %" in sentences[0]


@pytest.mark.parametrize(
    ("courses", "methods", "clear"),
    [
        (around(30, 20, count=8), BOTH, True),
        (around(20, 30, count=8), BOTH, True),
        (around(20, 20, count=8), BOTH, False),
        (around(30, 20, 20, count=8), THREE, False),
        (around(30, 20, 10, count=8), THREE, True),
        ([(20.0 + d, 20.0) for d in (3.0, -1.0, 2.0, 1.0, 4.0, -1.0, 1.0, 1.5)], BOTH, False),  # one-sided p = .036
    ],
)
def test_it_ends_once_one_method_is_clearly_better_than_each_of_the_others(courses, methods, clear):
    assert decided(mean_scores(pairs_of(*courses, methods=methods))) == clear


def test_half_driven_courses_and_further_trials_of_a_world_are_no_pairs_of_their_own():
    found = trials_of("a", {"dwa": 20.0, "applr": 10.0})
    found.update(trials_of("a", {"dwa": 30.0, "applr": 20.0}, trial=1))
    found.update(trials_of("b", {"dwa": 20.0}))
    trials = paired_trials(found, BOTH)
    scores = mean_scores(trials)
    assert (len(trials), scores.dwa.tolist(), scores.applr.tolist()) == (4, [25.0], [15.0])


def test_failures_are_named_by_their_reason():
    control = "planner aborted: Failed to find a valid control. Even after executing recovery behaviors."
    courses = [(control, control), (control, 20.0), ("time limit", 20.0), ("flipped", 20.0), ("flipped", 20.0)]
    assert judging.failures(pairs_of(*courses, ("strange", 20.0))) == [
        f"failed: {control[8:]} (2 with its own parameters, 1 with the policy)",
        "failed: flipped (2 with its own parameters)",
        "failed: time limit (1 with its own parameters)",
    ]


def fixed(settings, task, gain=10.0):
    """As training.evaluation.trials.drive; the policy takes 10 s less."""
    assert (settings.simulator, settings.monitor, settings.movers) == ("kinematic", True, True)
    seconds = 30.0 + task.seed % 7 - (gain + task.seed % 3) * (task.method == "applr")
    return TrialResult(success=True, time_s=seconds, reason="finished", decisions=5), b""


def slower(settings, task):
    return fixed(settings, task, -10.0)


CLOCK = [0.0]


def clocked(settings, task):
    """The first drive takes the time in which kernels are compiled, the others a second."""
    CLOCK[0] += 1.0 if CLOCK[0] else 600.0
    return fixed(settings, task)


@pytest.mark.parametrize(("runner", "status", "method"), [("fixed", 0, "applr"), ("slower", 1, "dwa")])
def test_the_command_ends_when_it_is_clear_and_continues(runner, status, method, tmp_path, capsys):
    words = ["turtlebot3_burger", "--workers", "0", "--out", str(tmp_path), "--runner", f"{__name__}:{runner}"]
    assert try_robot.main(words) == status
    printed = capsys.readouterr().out.splitlines()
    assert printed[0].startswith("On open floor turtlebot3_burger can, with its own parameters, drive straight on (")
    assert printed[1].startswith("Of 8 courses turtlebot3_burger finished 8 (100 %")
    assert printed[-1] == f"method: {method}"
    assert (tmp_path / "verdict.png").stat().st_size > 1000
    table = (tmp_path / "trials.csv").read_bytes()
    assert table.count(b"\n") == 1 + 2 * 8
    assert try_robot.main(words) == status
    assert (tmp_path / "trials.csv").read_bytes() == table
    assert capsys.readouterr().out.splitlines() == printed


def test_when_the_time_after_the_first_course_is_spent_it_ends_after_the_one_under_way(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(try_robot, "time", SimpleNamespace(monotonic=lambda: CLOCK[0]))
    words = ["turtlebot3_burger", "--workers", "0", "--out", str(tmp_path), "--runner", f"{__name__}:clocked"]
    assert try_robot.main([*words, "--minutes", "0.05"]) == 1
    printed = capsys.readouterr().out
    assert "Whether the policy pays on turtlebot3_burger is not clear" in printed
    assert "nan" not in printed
    assert (tmp_path / "trials.csv").read_text().count("\n") == 1 + 2 * 3


def test_a_mistake_is_one_line():
    done = subprocess.run(
        [sys.executable, "-m", "training.try_robot", "no_such"], cwd=ROOT, capture_output=True, text=True, timeout=HANGS
    )
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (1, "", 1)
    assert done.stderr.startswith("./applr try: robot is 'no_such': robot no_such: give husky")


def test_the_method_of_a_robots_file_is_what_auto_makes(tmp_path):
    robot = robots.load("turtlebot3_burger")
    folder = shutil.copytree(robot.folder, tmp_path / robot.name)
    with open(folder / "robot.yaml", "a", encoding="utf-8") as file:
        file.write("\nmethod: dwa\n")
    other = robots.load(folder)
    assert [methods.make("auto", one).name for one in (robot, other)] == ["applr", "dwa"]
    assert methods.make("auto", other).static
    assert content(other) == content(robot)  # no trial depends on it
