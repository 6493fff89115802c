"""./applr tune: what it is tuned for, where the search begins, the files that it leaves, the command with a toy."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import pytest
import rosparam
import yaml

import worlds
from applr_ros1 import robots
from applr_ros1.policy import methods
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots.measured import Value
from training import tune_robot
from training.evaluation.plan import TrialResult
from training.evaluation.score import AIMS
from training.report import verdict as judging
from training.tune import parameter_file
from training.tune.bag import Check

PAY = {"max_vel_x": 1.4, "sim_time": 1.1}  # of the toy's parameters the only ones that matter
DRIVEN = []  # trials, each of which takes a second


def toy(settings, task, gain=12.0):
    """As training.evaluation.trials.drive: the nearer to PAY, the faster; other parameters are nothing to it."""
    DRIVEN.append(task)
    robot = settings.load_robot()
    space = space_of(robot)
    theta = space.theta0 if task.method == "dwa" else task.theta or methods.make(task.method_spec, robot).theta(None)
    here = dict(zip(space.names, space.to_action(theta)))
    best = dict(zip(space.names, space.to_action(space.from_dict(PAY))))
    seconds = (
        12.0
        + task.seed % 3
        + (gain + gain * (task.seed % 7) / 40.0) * float(sum(abs(here[name] - best[name]) for name in PAY))
    )
    return TrialResult(success=True, time_s=seconds, reason="finished", decisions=5, route_m=10.0), b""


def none_better(settings, task):
    return toy(settings, task, 0.0)


def only_in_search(settings, task):
    """In the courses of the verdict nothing is left of it."""
    return toy(settings, task, 12.0 if task.method == "set" else 0.0)


@pytest.fixture
def few(monkeypatch):
    """Few courses, and time in which nothing but drives takes any."""
    monkeypatch.setattr(tune_robot, "WORLDS", "generated:1-12")
    monkeypatch.setattr(tune_robot, "UNSEEN", "generated:20-31")
    monkeypatch.setattr(tune_robot, "time", SimpleNamespace(monotonic=lambda: float(len(DRIVEN))))


@pytest.fixture
def jackal(tmp_path, few):
    """A folder of a Jackal that has nothing but its description."""
    left_out = shutil.ignore_patterns("static.json", "*.safetensors")
    return shutil.copytree(robots.JACKAL.folder, tmp_path / "jackal", ignore=left_out)


def tune(folder, runner, *more):
    words = [str(folder), "--workers", "0", "--out", str(folder.parent / "out"), "--minutes", "12", *more]
    return tune_robot.main([*words, "--runner", f"{__name__}:{runner}"])


def test_what_pays_is_found_written_judged_and_shown(jackal, tmp_path, capsys):
    assert tune(jackal, "toy") == 0
    printed = capsys.readouterr().out
    sentences = [line for line in printed.splitlines() if line.startswith(("Of 12 courses", "The tuned", "Load"))]
    assert sentences[0].count("finished 12 (100 %, 76 to 100 %) in ") == 1
    assert "touched something in 0 (0 %, 0 to 24 %) with the tuned parameters" in sentences[0]
    assert "The tuned parameters are better: by what --for fast counts they cost" in sentences[1]
    assert f"Load {jackal}/tuned.yaml after your own files" in sentences[2]
    robot = robots.load(str(jackal))
    space = space_of(robot)
    set_ = json.loads((jackal / "static.json").read_text())["parameters"]
    assert set(PAY) <= set(set_)
    assert len(set_) <= 5, "idle parameters stay out"
    assert set_["max_vel_x"] == pytest.approx(1.4, abs=0.3)
    assert methods.make("static", robot).theta(None).tolist() == space.from_dict(set_).tolist()
    page = next((tmp_path / "out").glob("fast_*/report/index.html")).read_text()
    assert page.index("The tuned parameters are better") < page.index("What changed") < page.index("Table")
    assert "Duration for which each sampled velocity is simulated." in page
    assert "0.5 m/s" in page
    searched = {task.world for task in DRIVEN if task.method == "set"}
    judged = {task.world for task in DRIVEN if task.method != "set"}
    assert len(searched) > 8
    assert not searched & judged


def test_blocks_begin_until_their_share_of_the_time_is_spent(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(tune_robot, "time", SimpleNamespace(monotonic=lambda: now[0]))

    def begun(before, fewest=1):
        now[0] = 7.0
        budget, found = tune_robot.Budget(100.0, before), []
        for block in budget.until(0.5, range(10), fewest):
            found.append(block)
            now[0] += 20.0
        return found

    assert begun(0.0) == [0, 1, 2]
    assert begun(15.0) == [0, 1]
    assert begun(60.0) == [0]
    assert begun(60.0, fewest=4) == [0, 1, 2, 3]


@pytest.mark.parametrize("runner", ["none_better", "only_in_search"])
def test_where_nothing_is_better_the_robots_folder_stays_as_it_is(runner, jackal, capsys):
    before = sorted(jackal.iterdir())
    assert tune(jackal, runner) == 1
    assert "Keep your own parameters" in capsys.readouterr().out
    assert sorted(jackal.iterdir()) == before


def test_an_interrupted_search_goes_on(jackal, tmp_path, capsys, monkeypatch):
    stop = tune_robot.write_json

    def interrupted(path, values):
        stop(path, values)
        if len(values["generations"]) == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(tune_robot, "write_json", interrupted)
    assert tune(jackal, "toy") == 130
    log = tmp_path / "out" / "search_fast.json"
    begun = json.loads(log.read_text())["generations"]
    monkeypatch.setattr(tune_robot, "write_json", stop)
    assert tune(jackal, "toy") == 0
    whole = json.loads(log.read_text())["generations"]
    assert len(whole) > len(begun) == 2
    assert whole[:2] == begun
    assert tune(jackal, "toy", "--seed", "1") == 0
    assert json.loads(log.read_text())["generations"][0] != begun[0]


def test_a_bags_courses_are_half_of_all_and_what_it_measures_is_the_robots(jackal, tmp_path, capsys, monkeypatch):
    names = ["hall", "hall-wall", *(f"hall-{n}" for n in range(1, 9))]
    agrees = [False]
    said = SimpleNamespace(
        worlds=[replace(worlds.load(f"generated:{50 + n}"), name=name) for n, name in enumerate(names)],
        courses=[None],
        fields={("laser", "noise"): Value(0.02, "m", 0.001, "52 scans")},
        remarks=["drive.bag: no map in tf"],
        check=lambda seed: Check(["hall: recorded 22 s, simulated 30 s"], agrees[0], "the simulator disagrees"),
    )
    monkeypatch.setattr(
        tune_robot.bag,
        "read",
        lambda paths, robot, copies: said if paths == [Path("drive.bag"), Path("b.bag")] else None,
    )
    before = (jackal / "robot.yaml").read_text()
    assert tune(jackal, "toy", "--bag", "drive.bag", "b.bag") == 1
    printed = capsys.readouterr()
    assert printed.err == "./applr tune: the simulator disagrees; give --anyway to go on all the same\n"
    assert "no map in tf" in printed.out
    assert "laser.noise: 0.02 m +- 0.001 (52 scans)" in printed.out
    assert (jackal / "robot.yaml").read_text() == before
    DRIVEN.clear()
    assert tune(jackal, "toy", "--bag", "drive.bag", "b.bag", "--anyway") == 0
    searched = {task.world for task in DRIVEN if task.method == "set"}
    judged = {task.world for task in DRIVEN if task.method != "set"}
    halls = [{name for name in found if "hall" in name} for found in (searched, judged)]
    assert halls[0] == {"hall", "hall-wall", "hall-3", "hall-4", "hall-7", "hall-8"}
    assert halls[1] == {"hall-1", "hall-2", "hall-5", "hall-6"}
    assert len(searched) == 12
    assert len(judged) == 8
    assert "noise: 0.02\n" in (jackal / "robot.yaml").read_text()
    assert robots.load(str(tmp_path / "out" / "jackal")).laser.noise == 0.02


def test_an_included_robots_folder_is_not_written_to(tmp_path, few):
    words = ["jackal", "--workers", "0", "--out", str(tmp_path), "--minutes", "5", "--runner", f"{__name__}:toy"]
    assert tune_robot.main(words) == 0
    assert (tmp_path / "tuned.yaml").exists()
    assert not (Path(robots.JACKAL.folder) / "tuned.yaml").exists()


def result(**values):
    return TrialResult(**{"success": True, "time_s": 12.0, "route_m": 10.0, "min_clearance_m": 0.3, **values})


def test_each_aim_prices_what_it_is_named_for():
    robot = robots.JACKAL  # at most 2 m/s: the optimal time is 5 s

    def cost(aim, **values):
        return AIMS[aim].seconds(result(**values), robot)

    assert cost("fast") == 12.0
    assert cost("fast", success=False, time_s=60.0) == 100.0
    assert cost("fast", collided=True) == 32.0
    assert cost("fast", min_clearance_m=0.1, mean_jerk=9.0, mean_turn=2.0) == 12.0
    assert cost("careful", min_clearance_m=0.2) > cost("careful", min_clearance_m=0.25, time_s=14.0)
    assert cost("careful", min_clearance_m=0.155) == 12.0 + 25.0
    assert cost("careful", min_clearance_m=0.5) == cost("careful", min_clearance_m=2.0) == 12.0
    assert cost("careful", collided=True) - cost("careful") > cost("fast", collided=True) - cost("fast")
    assert cost("smooth", mean_jerk=6.0) == pytest.approx(12.0 + 5.0 * 0.4 * 3.0)
    assert cost("smooth", mean_turn=2.0) == pytest.approx(12.0 + 5.0 * 4.0 * 0.5)


def test_the_search_begins_with_the_other_robots_sets_at_this_robots_size_and_speed():
    robot = robots.load("turtlebot3_waffle_pi")
    space = space_of(robot)
    starts = tune_robot.warm_starts(robot)
    assert starts[0].tolist() == space.theta0.tolist()
    assert len(starts) == 1 + 2 * 2, "of the other two that have one, and half-way to them"
    jackals = methods.make("static").theta(None)
    speed, share = space.names.index("max_vel_x"), jackals[0] / robots.JACKAL.base.max_speed
    fast = [theta for theta in starts if theta[speed] == pytest.approx(share * robot.base.max_speed, abs=1e-6)]
    assert len(fast) == 1
    assert fast[0][space.names.index("sim_time")] == pytest.approx(1.113)
    assert all((space.low <= theta).all() and (theta <= space.high).all() for theta in starts)


@pytest.mark.parametrize(
    ("name", "searched"),
    [
        ("jackal", ["min_in_place_vel_theta", "footprint_padding"]),
        ("husky", ["footprint_padding", "planner_frequency"]),  # its files plan once
        ("turtlebot3_burger", ["footprint_padding"]),
    ],
)
def test_a_robot_without_a_space_has_what_pays_for_searches_alone(name, searched, tmp_path):
    folder = shutil.copytree(robots.load(name).folder, tmp_path / name)
    described = yaml.safe_load((folder / "robot.yaml").read_text())
    described.pop("parameter_space", None)
    (folder / "robot.yaml").write_text(yaml.safe_dump(described, sort_keys=False))
    space = space_of(robots.load(str(folder)))
    assert list(space.fixed) == searched
    assert {"max_vel_x", "sim_time", "inflation_radius"} <= set(space.chosen.names)
    assert len(tune_robot.warm_starts(robots.load(str(folder)))) >= 5


@pytest.mark.parametrize("name", robots.NAMES)
def test_the_yaml_is_read_back_by_rosparam_and_by_this_package(name, tmp_path):
    """Loaded after the robot's own files it gives the set: into the parameter server, and as a file of robot.yaml."""
    folder = shutil.copytree(robots.load(name).folder, tmp_path / name)
    robot = robots.load(str(folder))
    space = space_of(robot)
    theta = space.clip(0.7 * space.low + 0.3 * space.high)
    values = {name: value for name, value in space.as_dict(theta).items() if name not in ("sim_time", "vx_samples")}
    parameter_file.write(robot, values, folder / "static.json", folder / "tuned.yaml")
    wanted = space.from_dict(values)
    assert methods.make("static", robot).theta(None).tolist() == wanted.tolist()
    ((loaded, namespace),) = rosparam.load_file(str(folder / "tuned.yaml"), default_namespace="move_base")
    assert namespace.strip("/") == "move_base"
    assert loaded == parameter_file.move_base_parameters(robot, values)
    assert loaded.get("TrajectoryPlannerROS", {}).get("meter_scoring") is (False if name == "jackal" else None)
    assert "sim_time" not in (folder / "tuned.yaml").read_text()
    described = yaml.safe_load((folder / "robot.yaml").read_text())
    described["move_base"]["without_map"]["files"] = [
        *described["move_base"]["without_map"].get("files", []),
        {"file": "tuned.yaml"},
    ]
    other = shutil.copytree(folder, tmp_path / "other" / name)
    (other / "robot.yaml").write_text(yaml.safe_dump(described, sort_keys=False))
    assert space_of(robots.load(str(other))).theta0.tolist() == wanted.tolist()


def test_the_verdict_names_what_gets_worse_although_it_is_faster():
    rows = []
    for number in range(30):
        for method, seconds in (("static", 12.0), ("dwa", 30.0)):
            failed = method == "static" and number == 3
            rows.append((f"w{number}", 0, method, not failed, False, seconds, "", 50.0 if failed else seconds))
    columns = ["world", "trial", "method", "success", "collided", "time_s", "reason", "score"]
    better, sentences = judging.tuned_verdict(pd.DataFrame(rows, columns=columns), "mine", "mine/tuned.yaml", "fast")
    assert better
    assert "although mine arrives less often with them" in sentences[1]
    assert sentences[0].index("with its own parameters") < sentences[0].index("with the tuned parameters")
    better, sentences = judging.tuned_verdict(
        pd.DataFrame(rows, columns=columns).replace({"dwa": "static", "static": "dwa"}), "mine", "x", "fast"
    )
    assert not better
    assert sentences[1].startswith("Nothing clearly better was found: by what --for fast counts they cost")
    assert sentences[2].startswith("Keep your own parameters")
