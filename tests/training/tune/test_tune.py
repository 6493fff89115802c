"""Tests of ./applr tune: its objectives, starting sets and files, and the command with toy
drives.
"""

import json
import re
import shutil
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pandas as pd
import pytest
import rosparam
import yaml

import worlds
from applr_ros1 import robots
from applr_ros1.policy import methods
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import JACKAL
from applr_ros1.robots import folder as robot_folder
from applr_ros1.robots.geometry import radius
from tests.support import scenes
from tests.support.pages import data_of
from training.attempts.loaded import move_base_parameters
from training.evaluate import evaluation
from training.evaluate.runner import TrialWorld
from training.evaluate.score import AIMS, Baseline
from training.evaluate.table import TrialTable
from training.evaluate.trial import Result, Trial
from training.tune import __main__ as tune_robot
from training.tune import best_set, found_set
from training.tune import clock as clocks

# Best values of the only parameters with an effect
PAY = {"max_vel_x": 1.4, "sim_time": 1.1}
WIDTH = JACKAL.body.size[1]
FEW = ["--workers", "0", "--worlds", "generated:1-12"]


class Driven(NamedTuple):
    """Driven trial.

    Attributes:
        task: The trial.
        loaded: Whether the planner starts with the parameter set.
        planner: Planner fidelity.
        monitor: Whether the collision monitor is on.
    """

    task: Trial
    loaded: bool
    planner: str
    monitor: bool

    @property
    def is_searched(self):
        """True if the search drives it, not the verdict."""
        return bool(self.task.theta)


DRIVEN = []  # each trial takes a second


def searched_tasks():
    """Return the trials that the search drove."""
    return [driven.task for driven in DRIVEN if driven.is_searched]


def judged_tasks():
    """Return the trials that the verdicts drove."""
    return [driven.task for driven in DRIVEN if not driven.is_searched]


def toy(settings, task, gain=12.0):
    """Return a result, like runner.run: the nearer the parameter set is to PAY, the faster."""
    DRIVEN.append(Driven(task, settings.loaded, settings.planner, settings.monitor))
    robot = settings.robot
    space = space_of(robot)
    if task.method == "dwa":
        theta = space.theta0
    else:
        theta = task.theta or methods.make(task.method_spec, robot).theta(None)

    # Distance from the best values, in shares of the ranges
    action = space.to_action(theta)
    best_action = space.to_action(space.from_dict(PAY))
    distance = 0.0
    for parameter_name in PAY:
        index = space.names.index(parameter_name)
        distance += float(abs(action[index] - best_action[index]))

    # Courses differ by up to 2 s, and in how much the set gains on them, as real ones do.
    course_time = 12.0 + task.seed % 3
    gain_on_course = gain * (1.0 + (task.seed % 7) / 40.0)
    result = Result(
        success=True,
        time_s=course_time + gain_on_course * distance,
        reason="finished",
        decisions=5,
        route_m=10.0,
    )
    return result, b""


def farther_is_better(settings, task):
    """Return results of drives that only the obstacle range changes, in the search and after it."""
    result, trace = toy(settings, task, 0.0)
    obstacle_range = task.obstacle_range or 2.5
    if not task.theta:
        obstacle_range = methods.make(task.method_spec, settings.robot).obstacle_range or 2.5
    return replace(result, time_s=result.time_s + 2.0 * abs(5.0 - obstacle_range)), trace


def none_better(settings, task):
    """Return results of drives that no parameter changes."""
    return toy(settings, task, 0.0)


def only_in_search(settings, task):
    """Return results that are better in the search but not on the courses of the verdict."""
    return toy(settings, task, 12.0 if task.theta else 0.0)


def better_without_monitor(settings, task):
    """Return results that the parameter set improves only without the monitor."""
    return toy(settings, task, 0.0 if settings.monitor else 12.0)


def better_with_monitor(settings, task):
    """Return results that are better in the search and in the verdict with the monitor, but not
    without it.
    """
    return toy(settings, task, 12.0 if settings.monitor or task.theta else 0.0)


def falls_with_monitor(settings, task):
    """Return results that are better but for a fall with the monitor."""
    result, trace = toy(settings, task)
    if settings.monitor and task.method == "static" and task.world == "generated:20":
        result = replace(result, success=False, reason="flipped")
    return result, trace


def none_arrives(settings, task):
    """Return results of drives that all end with the time limit."""
    result, trace = toy(settings, task)
    return replace(result, success=False, timeout=True), trace


@pytest.fixture
def few(monkeypatch):
    """Use few courses, and a clock on which each drive takes one second and everything else no
    time.
    """
    DRIVEN.clear()
    for module in (best_set, evaluation):
        monkeypatch.setattr(module, "run", toy)
    monkeypatch.setattr("training.tune.options.UNSEEN", "generated:20-31")
    monkeypatch.setattr(clocks, "time", SimpleNamespace(monotonic=lambda: float(len(DRIVEN))))
    monkeypatch.setattr(tune_robot.open_floor, "try_out", lambda robot: (True, []))


@pytest.fixture
def jackal(tmp_path, few):
    """Return a robot folder with the Jackal's description only."""
    without_sets = shutil.ignore_patterns("static.json", "*.safetensors")
    return shutil.copytree(JACKAL.folder, tmp_path / "jackal", ignore=without_sets)


def tune(folder, runner, *more):
    """Run the command with a function above as runner, and return its exit status."""
    robot_folder.forget()  # A command would start in a new process.
    best_set.run = evaluation.run = globals()[runner]
    output = str(Path(folder).parent / "out")
    return tune_robot.main([str(folder), "--out", output, "--minutes", "6", *more, *FEW])


@pytest.mark.slow
def test_the_verdicts_lie_in_the_half_of_a_building_that_the_search_did_not_use(jackal, tmp_path):
    office = scenes.write_plan(tmp_path, "office")
    arguments = f"{jackal} --out {tmp_path}/out --minutes 6 --workers 0 --worlds {office}"
    assert tune_robot.main(arguments.split()) == 0

    searched_worlds = {task.world_spec for task in searched_tasks()}
    (drives,) = (tmp_path / "out").glob("fast_*")
    judged_worlds = set()
    for monitor in ("with", "without"):
        evaluation_json = (drives / monitor / "evaluation.json").read_text()
        judged_worlds.update(json.loads(evaluation_json)["world_specs"])

    def x_of_paths(specifications):
        """Return the x [m] of all points of the paths through some worlds."""
        path_x = []
        for specification in specifications:
            course = worlds.load(specification, radius(JACKAL)).course
            path_x.extend(course.path[:, 0])
        return path_x

    assert max(x_of_paths(searched_worlds)) < min(x_of_paths(judged_worlds))


def test_a_better_set_is_found_judged_written_and_reported(jackal, tmp_path, capsys):
    assert tune(jackal, "toy", "--minutes", "12") == 0
    printed = capsys.readouterr().out
    # Two parameter sets are judged twice on 12 courses.
    assert "\n12 min of search, then 48 drives for the two verdicts\n" in printed
    # Progress lines count down.
    left_counts = re.findall(r"^reverting .*: (\d+) left$", printed, re.MULTILINE)
    assert left_counts
    assert list(map(int, left_counts)) == list(range(len(left_counts), 0, -1))

    # The verdict on each file
    for file_name, monitor in (("tuned.yaml", "without"), ("static.json", "with")):
        _, table = printed.split(f"\n{file_name}, {monitor} the collision monitor:\n")
        _, baseline_row, tuned_row, line, _, failures, written = table.splitlines()[:7]
        assert baseline_row.split()[:4] == ["dwa", "12", "12", "0"]
        assert tuned_row.split()[:4] == ["static", "12", "12", "0"]
        assert line.startswith("static better: yes, 12 of 12 arrive (dwa: 12); ")
        assert failures == "static fails on none of 12 courses"
        assert written == f"written: {jackal}/{file_name}"
    # The set has the parameters that pay, and few others.
    robot = robots.load(str(jackal))
    space = space_of(robot)
    tuned_set = json.loads((jackal / "static.json").read_text())["parameters"]
    assert set(PAY) <= set(tuned_set)
    assert len(tuned_set) <= 5, "parameters without effect are pruned"
    assert tuned_set["max_vel_x"] == pytest.approx(1.4, abs=0.3)
    theta = methods.make("static", robot).theta(None)
    assert theta.tolist() == space.from_dict(tuned_set).tolist()

    # The page says the same.
    (drives,) = (tmp_path / "out").glob("fast_*")
    page_text = (drives / "index.html").read_text()
    search_line = "searched on 12 courses of generated:1-12, "
    assert printed.index(f"\n{search_line}") < printed.index("\ntuned.yaml, without")
    assert f"\nfor a building and its doors: ./applr tune {jackal} --worlds MAP.yaml\n" in printed
    assert f"page: {drives}/index.html\n" in printed
    assert "tuned.yaml: static better: yes, 12 of 12 arrive (dwa: 12); " in page_text
    page_data = data_of(page_text)
    assert [row["parameter"] for row in page_data["changes"]] == list(tuned_set)
    assert page_data["scope"].startswith(search_line)
    assert page_data["yaml"] == (jackal / "tuned.yaml").read_text()

    # Why the parameters are changed
    changes = pd.read_csv(drives / "changes.csv", index_col="parameter")
    assert changes["default"]["max_vel_x"] == "0.5 m/s"
    meaning = "Duration for which each sampled velocity is simulated."
    assert changes["meaning"]["sim_time"] == meaning
    assert (changes["95 % low"] <= changes["without it [s]"]).all()
    assert changes["effect"]["max_vel_x"] == "saves"

    # How it was measured
    _, _, from_heading_on = page_text.partition("How it was measured")
    measured, _, _ = from_heading_on.partition("</details>")
    without_monitor, _, with_monitor = measured.partition("<p>static.json:</p>")
    for conditions, monitor in ((without_monitor, "False"), (with_monitor, "True")):
        assert f"loaded True, matched True, monitor {monitor}, " in conditions
        assert "planner cpp-like" in conditions

    # Search and verdicts drive on different courses, with the planner that the page names.
    searched_worlds = {task.world for task in searched_tasks()}
    judged_worlds = {task.world for task in judged_tasks()}
    assert len(searched_worlds) > 8
    assert not searched_worlds & judged_worlds
    padding = space.names.index("footprint_padding")
    for driven in DRIVEN:
        assert driven.loaded, "tuned.yaml is loaded, too"
        assert driven.planner == "cpp-like"
        if driven.is_searched:
            assert driven.task.theta[padding] == 0.1, "it would act differently by reconfigure"


def test_a_clock_yields_blocks_until_their_share_has_passed_and_continues_after_a_stop(
    tmp_path, monkeypatch
):
    # A list, so that the functions within can change the time [s].
    computer_time = [7.0]
    monkeypatch.setattr(clocks, "time", SimpleNamespace(monotonic=lambda: computer_time[0]))

    def driven_blocks(clock):
        """Return the blocks that begin within half of the 100 s. Each takes 20 s."""
        blocks = []
        for block in clock.until(0.5, range(10)):
            blocks.append(block)
            computer_time[0] += 20.0
        return blocks

    # The third block begins at 40 s. Once the time is over, one block is driven all the same.
    table = TrialTable(tmp_path, {})
    clock = clocks.SearchClock(table, "readings", 100.0)
    assert driven_blocks(clock) == [0, 1, 2]
    assert driven_blocks(clock) == [0]

    # A run that was stopped goes on at the readings it wrote, whatever the computer's clock shows.
    computer_time[0] = 1000.0
    continued = clocks.SearchClock(table, "readings", 100.0)
    assert list(continued.until(0.5, range(10))) == [0, 1, 2]
    assert list(continued.until(0.5, range(10))) == [0]
    computer_time[0] += 3.0
    assert continued.spent() == pytest.approx(0.83)


@pytest.mark.parametrize("runner", ["none_better", "only_in_search"])
def test_if_nothing_is_better_the_robots_folder_is_unchanged(runner, jackal, capsys):
    files_before = sorted(jackal.iterdir())
    assert tune(jackal, runner) == 1
    printed = capsys.readouterr().out
    assert "better: no, " in printed
    assert "better: yes" not in printed
    assert (
        "\nnothing written: the set is in " in printed
        or "no changed parameter saves anything" in printed
    )
    assert sorted(jackal.iterdir()) == files_before
    # What to do comes last, once.
    *_, hint = [line for line in printed.splitlines() if not line.startswith("page: ")]
    assert hint == found_set.NEXT
    assert printed.count(found_set.NEXT) == 1


def test_after_a_no_more_minutes_continue_the_search_and_another_seed_begins_one(jackal, tmp_path):
    assert tune(jackal, "only_in_search") == 1
    driven_at_first = len(searched_tasks())
    # The same command drives nothing and says no again.
    assert tune(jackal, "only_in_search") == 1
    assert len(searched_tasks()) == driven_at_first
    tune(jackal, "only_in_search", "--minutes", "12")
    assert len(searched_tasks()) > driven_at_first
    assert len(list((tmp_path / "out").glob("search-*"))) == 1
    tune(jackal, "only_in_search", "--seed", "1")
    assert len(list((tmp_path / "out").glob("search-*"))) == 2


@pytest.mark.parametrize(
    ("runner", "files"),
    [
        ("better_without_monitor", {"tuned.yaml"}),
        ("better_with_monitor", {"static.json"}),
        ("falls_with_monitor", {"tuned.yaml"}),
    ],
)
def test_tuned_yaml_is_searched_and_judged_without_the_monitor_and_static_json_judged_with_it(
    runner, files, jackal, capsys
):
    files_before = set(jackal.iterdir())
    assert tune(jackal, runner) == 0
    printed = capsys.readouterr().out
    assert (found_set.ONLY_WITH_MONITOR in printed) == (files == {"static.json"})
    fall = "; it falls over in 1 drive: lower base.max_speed in robot.yaml"
    assert (fall in printed) == (runner == "falls_with_monitor")
    new_files = set(jackal.iterdir()) - files_before
    assert {file.name for file in new_files} == files
    judged_with_monitor = []
    for driven in DRIVEN:
        if driven.is_searched:
            assert not driven.monitor
        else:
            judged_with_monitor.append(driven.monitor)
    # Two methods on twelve courses, for tuned.yaml and then for static.json.
    assert judged_with_monitor == [False] * 24 + [True] * 24


def test_if_no_set_arrives_the_error_names_a_demo_that_shows_why(jackal, capsys):
    assert tune(jackal, "none_arrives") == 1
    demo = f"./applr demo robot:={jackal} method:=dwa world:=generated:"
    printed = capsys.readouterr()
    assert f"no set arrives on any course, so there is nothing to compare: {demo}" in printed.err
    assert "better:" not in printed.out


def test_a_robot_that_fails_on_open_floor_is_tuned_only_with_anyway(jackal, capsys, monkeypatch):
    monkeypatch.setattr(
        tune_robot.open_floor, "try_out", lambda robot: (False, ["The set-up is wrong."])
    )
    assert tune(jackal, "toy") == 1
    assert capsys.readouterr().out == "The set-up is wrong.\n"
    assert not DRIVEN
    assert tune(jackal, "toy", "--anyway") == 0


def test_a_robot_that_cannot_do_what_its_description_states_is_refused_before_any_drive(
    jackal, capsys
):
    robot_yaml = jackal / "robot.yaml"
    robot_yaml.write_text(robot_yaml.read_text().replace("grip_limit: 3.7", "grip_limit: 1.5"))
    assert tune(jackal, "toy") == 1
    assert "monitor.deceleration is 1.9: with simulation.grip_limit 1.5" in capsys.readouterr().err
    assert not DRIVEN


@pytest.mark.fault("19")
def test_a_stopped_run_continues_and_drives_nothing_twice(jackal, monkeypatch):
    # Ctrl-C after the sixth reading of the clock, in the middle of the search.
    note = TrialTable.note

    def stop(table, **values):
        note(table, **values)
        if len(values.get("readings_fast", ())) == 6:
            raise KeyboardInterrupt

    monkeypatch.setattr(TrialTable, "note", stop)
    assert tune(jackal, "toy") == 130
    monkeypatch.setattr(TrialTable, "note", note)
    count_before = len(DRIVEN)
    assert count_before
    assert tune(jackal, "toy") == 0
    assert len(DRIVEN) > count_before
    assert len(set(DRIVEN)) == len(DRIVEN)
    tuned_set = json.loads((jackal / "static.json").read_text())["parameters"]
    assert tuned_set["max_vel_x"] == pytest.approx(1.4, abs=0.3)


def test_progress_lines_count_courses_however_many_sets_drive_them(jackal, monkeypatch):
    works = []

    @contextmanager
    def announced(work, report, *times):
        works.append(work)
        yield

    monkeypatch.setattr(best_set, "announced", announced)
    assert tune(jackal, "toy") == 0
    driven_courses = 0
    courses_of_one_set = 0
    for work in works:
        driven, with_each = re.fullmatch(
            r"driving (\d+) courses in \w+ \((\d+) with each set\)", work
        ).groups()
        assert int(driven) % int(with_each) == 0
        driven_courses += int(driven)
        courses_of_one_set += int(with_each)
    # Some lines are of several sets.
    assert driven_courses > courses_of_one_set


def test_a_finished_run_searches_on_from_its_result(jackal, capsys):
    for _ in range(2):
        assert tune(jackal, "toy", "--minutes", "4") == 0
        line = re.search(r"best of (\d+) starting sets: ", capsys.readouterr().out)
    # The robot's new set is among the starting sets of the second run.
    assert int(line[1]) == len(best_set.warm_starts(robots.load(str(jackal))))


def test_an_included_robots_folder_is_not_written_to(tmp_path, few):
    assert tune("jackal", "toy", "--out", str(tmp_path), "--minutes", "5") == 0
    assert (tmp_path / "tuned.yaml").exists()
    assert not (Path(JACKAL.folder) / "tuned.yaml").exists()


@pytest.mark.parametrize(
    ("aim", "change", "cost"),
    [
        # 20, 100 and 60 optimal times of 5 s
        ("fast", {"success": False, "time_s": 60.0}, 100.0),
        ("careful", {"success": False}, 500.0),
        ("smooth", {"success": False}, 300.0),
        # Five optimal times slower than the baseline
        ("careful", {"time_s": 45.0}, 45.0 + 10.0 * 25.0),
        ("smooth", {"time_s": 45.0}, 45.0 + 10.0 * 25.0),
        (
            "fast",
            {"time_s": 40.0, "mean_clearance_m": 0.1, "mean_jerk": 9.0, "mean_turn": 2.0},
            40.0,
        ),
        # A tenth of a width of clearance below three widths
        ("careful", {"mean_clearance_m": 2.9 * WIDTH}, 12.0 + 5.0 * 0.1 * 60.0),
        # Relative to the baseline's jerk of 8 and turning of 1
        ("smooth", {"mean_jerk": 6.0}, 12.0 + 5.0 * 15.0 * 0.75),
        ("smooth", {"mean_turn": 2.0}, 12.0 + 5.0 * 10.0 * 2.0),
    ],
)
def test_each_objective_charges_the_quantity_in_its_name(aim, change, cost):
    usual = Result(success=True, time_s=12.0, route_m=10.0, mean_clearance_m=3.0 * WIDTH)
    result = replace(usual, **change)
    assert AIMS[aim].cost(result, JACKAL, Baseline(4.0, 8.0, 1.0)) == pytest.approx(cost)


def test_the_search_begins_with_the_other_robots_sets_at_this_robots_size_and_speed():
    robot = robots.load("turtlebot3_waffle_pi")
    space = best_set.search_space(robot)
    starts = best_set.warm_starts(robot)
    assert starts[0].tolist() == space.theta0.tolist()
    assert len(starts) == 1 + 2 * 3, (
        "the defaults, three sets of robots, and a set half-way to each"
    )
    own_set = methods.make("static", robot).theta(None)
    differences = np.abs(starts[:, :-1] - own_set).max(axis=1)
    assert differences.min() < 1e-6
    assert (starts >= space.low).all()
    assert (starts <= space.high).all()

    # The Jackal's set drives at the same share of the largest speed, and looks ahead as long.
    jackals_speed = methods.make("static").theta(None)[0]
    speed = jackals_speed / JACKAL.base.max_speed * robot.base.max_speed
    speeds = starts[:, space.names.index("max_vel_x")]
    (jackals_row,) = np.flatnonzero(np.isclose(speeds, speed, atol=1e-6))
    assert starts[jackals_row, space.names.index("sim_time")] == pytest.approx(1.113)


JACKALS_SEARCHED = [
    "min_in_place_vel_theta",
    "escape_reset_dist",
    "escape_reset_theta",
    "footprint_padding",
]


@pytest.mark.parametrize(
    ("name", "searched"),
    [
        ("jackal", JACKALS_SEARCHED),
        ("husky", ["footprint_padding", "planner_frequency"]),  # its move_base plans only once
        ("turtlebot3_burger", ["footprint_padding"]),
    ],
)
def test_the_default_space_has_more_parameters_for_searches(name, searched, tmp_path):
    # Given: a robot without a parameter_space in its robot.yaml
    folder = shutil.copytree(robots.load(name).folder, tmp_path / name)
    robot_yaml = folder / "robot.yaml"
    description = yaml.safe_load(robot_yaml.read_text())
    description.pop("parameter_space", None)
    robot_yaml.write_text(yaml.safe_dump(description, sort_keys=False))
    robot = robots.load(str(folder))

    # Then: a search has further parameters, and starting sets of other robots
    space = space_of(robot)
    assert list(space.fixed) == searched
    assert {"max_vel_x", "sim_time", "inflation_radius"} <= set(space.chosen.names)
    assert len(best_set.warm_starts(robot)) >= 5


def test_the_obstacle_range_is_searched_judged_and_written_for_the_start_of_move_base(
    jackal, tmp_path
):
    assert tune(jackal, "farther_is_better") == 0

    # It is no live parameter: the set's method says it, and the YAML file loads it.
    written = json.loads((jackal / "static.json").read_text())
    assert written["obstacle_range"] == pytest.approx(5.0, abs=0.5)
    assert "obstacle_range" not in written["parameters"]
    robot = robots.load(str(jackal))
    assert methods.make("static", robot).obstacle_range == written["obstacle_range"]
    for searched in searched_tasks():
        assert len(searched.theta) == len(space_of(robot))
    # The defaults drive with the files as they are.
    assert searched_tasks()[0].obstacle_range is None
    loaded = yaml.safe_load((jackal / "tuned.yaml").read_text())
    for costmap in ("global_costmap", "local_costmap"):
        source = loaded[costmap]["obstacles_layer"]["scan"]
        assert source["obstacle_range"] == written["obstacle_range"]
        assert source["raytrace_range"] == pytest.approx(written["obstacle_range"] + 0.5)

    # The table of changes has it, like any other parameter.
    (drives,) = (tmp_path / "out").glob("fast_*")
    changes = pd.read_csv(drives / "changes.csv", index_col="parameter")
    assert changes["default"]["obstacle_range"] == "2.5 m"
    assert changes["effect"]["obstacle_range"] == "saves"


def test_a_search_tries_ranges_that_the_laser_has_and_none_for_a_robot_with_two(tmp_path):
    for name, farthest in (("jackal", 8.0), ("turtlebot3_burger", 3.47)):
        space = best_set.search_space(robots.load(name))
        assert space.names[-1] == "obstacle_range"
        assert space.high[-1] == pytest.approx(farthest, abs=0.01)
        assert space.low[-1] < space.theta0[-1]
    local = {"local_costmap": {"obstacles_layer": {"scan": {"obstacle_range": 2.0}}}}
    space = best_set.search_space(JACKAL.with_parameters(local, "jackal"))
    assert space.names == space_of(JACKAL).names

    # Nor for one whose files have the only range that its laser allows
    short_laser = JACKAL.laser.model_copy(update={"range_max": 1.0})
    short_sighted = replace(JACKAL.seeing(1.0), laser=short_laser)
    assert best_set.search_space(short_sighted).names == space_of(JACKAL).names


def test_the_scope_is_the_distance_of_obstacles_from_the_paths():
    """A passage is wider: its path need not lead through the middle, as here with 0.4 m and 1 m."""
    path = np.array([(0.0, 0.0), (0.0, 4.0)])
    course = worlds.Course((0.0, 0.0, 0.0), (0.0, 4.0, 0.0), None, 0.5, path)
    left_post = (-0.6, 0.0, 0.2)
    trial_worlds = []
    for right_x in (0.5, 1.2):
        posts = np.array([left_post, (right_x, 4.0, 0.2)])
        world = worlds.World("posts", posts, np.zeros((0, 5)), course)
        trial_worlds.append(TrialWorld("posts", "posts", world))
    options = tune_robot.TuneOptions(robot=JACKAL, worlds="office.yaml")
    assert found_set.scope(options, trial_worlds, trial_worlds[1:]) == (
        "searched on 2 courses of office.yaml, with obstacles 0.30 to 0.40 m beside the path; "
        "judged on 1 others, with obstacles 0.40 to 0.40 m beside the path; "
        "half of the padded footprint's width is 0.27 m"
    )


@pytest.mark.parametrize("name", robots.NAMES)
def test_the_yaml_is_read_back_by_rosparam_and_by_this_package(name, tmp_path):
    """Loaded after the robot's files, tuned.yaml gives the parameter set: on the parameter server
    and in robot.yaml.
    """
    folder = shutil.copytree(robots.load(name).folder, tmp_path / name)
    robot = robots.load(str(folder))
    space = space_of(robot)
    # A set that leaves two parameters at their defaults, which the file must not have.
    values = space.as_dict(space.clip(0.7 * space.low + 0.3 * space.high))
    for left_out in ("sim_time", "vx_samples"):
        values.pop(left_out, None)
    tuned_yaml = folder / "tuned.yaml"
    found_set.write_set(robot, values, folder / "static.json", tuned_yaml)
    expected_theta = space.from_dict(values)
    assert methods.make("static", robot).theta(None).tolist() == expected_theta.tolist()
    if name == "jackal":  # the padding would change the outline of the planner, too
        expected_theta = space.from_dict({**values, "footprint_padding": 0.1})

    # rosparam reads it.
    ((loaded, namespace),) = rosparam.load_file(str(tuned_yaml), default_namespace="move_base")
    assert namespace.strip("/") == "move_base"
    assert loaded == move_base_parameters(robot, values)

    # The weights are in the unit of the robot's own files, which the file says.
    meter_scoring = loaded.get("TrajectoryPlannerROS", {}).get("meter_scoring")
    content = tuned_yaml.read_text()
    if name == "jackal":
        assert meter_scoring is False
        assert "# The distance biases below are per costmap cell, as in C++" in content
    else:
        assert meter_scoring is None
        assert "# The distance biases below are per metre, as in C++" in content
    assert "sim_time" not in content

    # This package reads it, as one more file of robot.yaml.
    description = yaml.safe_load((folder / "robot.yaml").read_text())
    without_map = description["move_base"]["without_map"]
    without_map.setdefault("files", []).append({"file": "tuned.yaml"})
    other_folder = shutil.copytree(folder, tmp_path / "other" / name)
    (other_folder / "robot.yaml").write_text(yaml.safe_dump(description, sort_keys=False))
    other_robot = robots.folder.read(str(other_folder))
    assert space_of(other_robot).theta0.tolist() == expected_theta.tolist()
