"""Tests of evaluate.py: plan, seeds, trials.csv after a kill, incomplete rows, dying workers, and
one-line errors.

A toy runner replaces the drives. The last tests use the real runner.
"""

import csv
import itertools
import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from applr_ros1.common.errors import ApplrError
from applr_ros1.drives.end_rules import Rules
from applr_ros1.policy import methods
from applr_ros1.policy.actor import save
from applr_ros1.policy.parameter_space import SPACE
from tests.support import HANGS, ROOT, lines_with, runs
from tests.support.drives import driven
from tests.support.robots import make_weights
from training.env.settings import TrialSettings
from training.evaluate import __main__ as evaluate
from training.evaluate import runner
from training.evaluate.evaluation import EvaluationOptions
from training.evaluate.evaluation import evaluate as evaluate_all
from training.evaluate.table import TrialTable, read_trace, read_trials
from training.evaluate.trial import Result, Trial, plan_trials, seed_of

# Columns that scripts of users rely on: new ones come after these.
HEADER = "world,method,trial,seed,success,collided,timeout,time_s,decisions,path_length_m,"


def command(out, *more, worlds="generated:0,generated:7,generated:64", chosen="dwa,random"):
    """Return the arguments of an evaluation of four trials in each world, and more of them."""
    plan = ["--worlds", worlds, "--methods", chosen, "--trials", "4"]
    arguments = [*plan, "--out", out, "--no-report", *more]
    return list(map(str, arguments))


# evaluate.py in a process of its own, with the toy runner
TOY = """
import sys
from tests.support.runs import (draw_result)
from training.evaluate import __main__ as evaluate
from training.evaluate import evaluation
evaluation.run = draw_result
sys.exit(evaluate.main())
"""


MY_MODULE = """
from applr_ros1.policy.methods import Method
from applr_ros1.policy.parameter_space import SPACE

class Cautious(Method):
    def reset(self, seed):
        self.seed = seed

    def theta(self, context):
        return SPACE.from_dict({'max_vel_x': 0.7})

class Nothing:
    pass
"""


@pytest.fixture
def run(monkeypatch):
    """Return run(arguments), which runs evaluate.py in this process with instant trials and returns
    its exit status.
    """
    monkeypatch.setenv("TOY_SECONDS", "0")
    monkeypatch.setattr("training.evaluate.evaluation.run", runs.draw_result)

    def run(arguments):
        monkeypatch.setattr(sys, "argv", ["evaluate.py", *arguments])
        return evaluate.main([*arguments, "--workers", "0"])

    return run


@pytest.fixture
def refused(run, capsys):
    """Return refused(arguments, *words), which checks that evaluate.py ends with a one-line error
    with the words.
    """

    def refused(arguments, *words):
        capsys.readouterr()
        assert run(arguments) == 1
        printed = capsys.readouterr().err
        error_lines = lines_with(printed, "./applr evaluate: ")
        assert len(error_lines) == 1, printed
        assert "Traceback" not in printed, printed
        for word in words:
            assert word in error_lines[0], error_lines[0]

    return refused


# -- plan ------------------------------------------------------------------------------------------
def test_every_method_gets_the_same_seeds_in_any_evaluation():
    worlds = [("a", "a"), ("b", "b")]
    two_methods = [("x", "x"), ("y", "y")]
    whole_plan = plan_trials(worlds, two_methods, trials=3, seed=5)
    small_plan = plan_trials(worlds[1:], two_methods[1:], trials=3, seed=5)

    seeds = {}
    for trial in whole_plan:
        seeds[trial.world, trial.trial, trial.method] = trial.seed
    for world, number in itertools.product("ab", range(3)):
        assert seeds[world, number, "x"] == seeds[world, number, "y"]
    for number, trial in enumerate(small_plan):
        assert trial.seed == seeds["b", number, "y"]
    assert [trial.trace for trial in small_plan] == [True, False, False]
    assert len(set(seeds.values())) == 6
    assert seeds["a", 0, "x"] != seed_of(6, "a", 0)

    # A fourth trial only appends rows.
    longer_plan = plan_trials(worlds, two_methods, trials=4, seed=5)
    assert whole_plan == longer_plan[:12]


def test_seeds_are_those_of_older_evaluations():
    """Trials are compared with those of earlier tables, which had the same seeds."""
    stored = ROOT / "tests" / "golden" / "evaluation"
    settings = json.loads((stored / "evaluation.json").read_text())
    worlds = list(zip(settings["worlds"], settings["world_specs"]))
    chosen = [(name, name) for name in settings["methods"]]
    plan = plan_trials(worlds, chosen, trials=2, seed=settings["seed"])
    assert [trial.seed for trial in plan] == read_trials(stored / "trials.csv").seed.tolist()


# -- the folder ------------------------------------------------------------------------------------
def test_csv_begins_with_the_pinned_columns(tmp_path, run):
    assert run(command(tmp_path)) == 0
    lines = (tmp_path / "trials.csv").read_text().splitlines()
    assert lines[0].startswith(HEADER)
    assert len(lines) == 1 + 3 * 2 * 4
    table_rows = list(csv.DictReader(lines))
    # Trials, then worlds, then methods, so that a stopped run has all methods in some worlds.
    first_trials = [(row["trial"], row["world"], row["method"]) for row in table_rows[:3]]
    assert first_trials == [
        ("0", "generated:0", "dwa"),
        ("0", "generated:0", "random"),
        ("0", "generated:7", "dwa"),
    ]
    for table_row in table_rows:
        assert table_row["success"] in ("True", "False")

    # What a reader of the table must know to repeat it
    settings = json.loads((tmp_path / "evaluation.json").read_text())
    assert settings["methods"]["dwa"]["parameters"]["max_vel_x"] == 0.5
    assert isinstance(settings["wall_s"], float)
    (session,) = settings["provenance"]
    assert session["trials"] == 24
    assert session["seed"] == 0
    assert session["versions"]["numpy"] == np.__version__
    assert re.match(r"\d{4}-\d\d-\d\dT", session["date"])
    assert re.match(r"[0-9a-f]{40}|unknown", session["commit"])
    assert "--methods dwa,random" in session["command"]
    assert session["cpu"]


@pytest.mark.fault("19")
def test_killed_and_started_again_gives_the_same_rows(tmp_path, run):
    """A run with workers is stopped by Ctrl-C, continued, killed, and finished without workers."""
    whole_run = tmp_path / "whole"
    killed_run = tmp_path / "killed"
    assert run(command(whole_run)) == 0
    for signal_number, status in ((signal.SIGINT, 130), (signal.SIGKILL, -signal.SIGKILL)):
        process = subprocess.Popen(
            [sys.executable, "-c", TOY, *command(killed_run, "--workers", 1)],
            cwd=ROOT,
            env=dict(os.environ, PYTHONPATH=str(ROOT), TOY_SECONDS="0.2"),
            stderr=subprocess.DEVNULL,
        )
        # Three trials, and then the signal
        deadline = time.monotonic() + HANGS
        row_count = _rows(killed_run) + 3
        while _rows(killed_run) < row_count and process.poll() is None:
            assert time.monotonic() < deadline, "no more rows"
            time.sleep(0.05)
        process.send_signal(signal_number)
        assert process.wait(HANGS) == status
    assert 0 < _rows(killed_run) < 24
    assert run(command(killed_run)) == 0
    killed_table = (killed_run / "trials.csv").read_bytes()
    assert killed_table == (whole_run / "trials.csv").read_bytes()


def _rows(folder):
    """Return the number of stored trials."""
    return len(read_trials(folder / "trials.csv"))


def test_tables_have_the_order_of_the_plan_for_any_order_of_trials(tmp_path):
    plan = plan_trials([("w", "w"), ("v", "v")], [("m", "m")], 3, seed=0)
    for begin in (0, 3):  # a second session continues
        with TrialTable(tmp_path, {}) as table:
            assert len(table.missing(plan)) == len(plan) - begin
            for task in plan[::-1][begin : begin + 3]:
                table.add(task, Result(time_s=math.pi, path_length_m=1.0))
            table.order(plan)
            assert table.added == 3
    table_rows = read_trials(tmp_path / "trials.csv").to_dict("records")
    for table_row, task in zip(table_rows, plan, strict=True):
        assert table_row["world"] == task.world
        assert table_row["trial"] == task.trial
    # Numbers of a table have four places.
    assert table_rows[0]["time_s"] == 3.1416
    assert table_rows[0]["path_length_m"] == 1.0
    assert table_rows[0]["success"] is False


def test_a_trial_with_an_incomplete_row_is_driven_again_and_others_are_unchanged(tmp_path):
    plan = plan_trials([("w", "w")], [("m", "m")], 2, seed=0)
    first_task, second_task = plan
    # Text and numbers that a careless reader of the table would take for others
    driven_result = Result(
        True,
        time_s=math.pi,
        reason='planner aborted: "no way", NA',
        min_clearance_m=math.inf,
        contact_speed=0.25,
    )
    stored_result = replace(driven_result, time_s=3.1416)
    with TrialTable(tmp_path, {}) as table:
        assert table.add(first_task, driven_result) == stored_result
        assert table.add(second_task, driven_result) == stored_result
        table.note(looks=[0.1])

    # The end of the last row is missing, as after a loss of power.
    table_file = tmp_path / "trials.csv"
    table_file.write_bytes(table_file.read_bytes()[:-3])
    with TrialTable(tmp_path, {}) as table:
        assert table.notes == {"looks": [0.1]}
        assert table.result(first_task) == stored_result
        assert table.missing(plan) == [second_task]
        assert table.add(second_task, driven_result) == table.result(second_task)
    with TrialTable(tmp_path, {}) as table:
        assert table.result(second_task) == stored_result


def test_the_result_is_printed(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("TOY_SECONDS", "0")
    monkeypatch.setattr("training.evaluate.evaluation.run", runs.draw_result)
    for chosen, line in (
        ("dwa", "dwa alone was driven.\n"),
        ("dwa,random", "\nrandom better: "),
    ):
        worlds = ["--worlds", "generated:0-5", "--trials", "1", "--workers", "0"]
        assert evaluate.main([*worlds, "--methods", chosen, "--out", str(tmp_path / chosen)]) == 0
        assert line in capsys.readouterr().out


def test_the_number_of_trials_is_that_of_the_table(tmp_path, run, capsys):
    few = {"worlds": "generated:0", "chosen": "dwa"}
    for trial_count, printed in ((1, "1 trial"), (2, "2 trials"), (1, "2 trials")):
        assert run(command(tmp_path, "--trials", trial_count, **few)) == 0
        assert capsys.readouterr().out == f"{printed} in {tmp_path}/trials.csv\n"


def test_an_evaluation_that_differs_is_refused_with_what_differs(tmp_path, run, refused):
    # Given: an evaluation of methods from files
    out = tmp_path / "out"
    set_file = tmp_path / "mine.json"
    set_file.write_text('{"obstacle_range": 4.0, "parameters": {"max_vel_x": 1.0}}')
    policy_file = tmp_path / "actor.safetensors"
    save(policy_file, make_weights(), {"steps": 1})
    module = tmp_path / "mine.py"
    module.write_text(MY_MODULE)
    chosen = f"dwa,{set_file},{policy_file},{module}:Cautious"
    first_command = command(out, chosen=chosen)
    assert run(first_command) == 0
    assert run(first_command) == 0

    # Then: the same command with another option is refused, what others depend on first
    for options, change in (
        (["--seed", "3"], "seed 0, not 3"),
        (["--monitor"], "monitor False, not True"),
        (["--no-matched"], "matched True, not False"),
        (["--movers"], "movers False, not True"),
        (["--loaded"], "loaded False, not True"),
        (["--robot", "husky", "--methods", "dwa"], "robot.name 'jackal', not 'husky'"),
        (["--protocol", "barn-challenge"], "protocol 'paper', not 'barn-challenge'"),
        (["--worlds", "generated:1"], "worlds ['generated:0', "),
        (["--methods", "dwa"], "methods.mine {"),
    ):
        refused([*first_command, *options], f"{out} was driven otherwise, with {change}")
    remedy = ": give another --out"
    refused([*first_command, "--seed", "3"], remedy)

    # A method is another one if its file has changed.
    module.write_text(MY_MODULE + "# another comment\n")
    refused(first_command, "methods.Cautious.source_sha256 ", remedy)
    save(policy_file, make_weights(), {"steps": 2})
    refused(first_command, "methods.actor.sha256 ", remedy)
    set_file.write_text('{"obstacle_range": 5.0, "parameters": {"max_vel_x": 1.0}}')
    refused(first_command, f"methods.mine.obstacle_range 4.0, not 5.0{remedy}")
    set_file.write_text('{"obstacle_range": 4.0, "parameters": {"max_vel_x": 1.2}}')
    refused(first_command, f"methods.mine.parameters.max_vel_x 1.0, not 1.2{remedy}")

    # The remedy works.
    assert run(command(tmp_path / "another", chosen=chosen)) == 0


def test_out_must_be_a_folder(tmp_path, refused):
    file = tmp_path / "stopped.bag"
    file.write_text("a bag")
    remedy = "give another folder with --out"
    refused(command(file), f"{file}: a file, not a folder; {remedy}")
    below = file / "results"
    refused(command(below), f"{below}: this folder cannot be made (Not a directory); {remedy}")
    assert file.read_text() == "a bag"


def test_trial_that_fails_and_simulator_that_breaks_are_one_line(tmp_path, refused, monkeypatch):
    (tmp_path / "bad.json").write_text("{}")
    arguments = command(tmp_path, chosen=f"dwa,{tmp_path}/bad.json")
    refused(arguments, "trial 0 of bad in generated:", " failed: the toy will not")
    monkeypatch.setenv("TOY_BROKEN", "1")
    refused(command(tmp_path / "b"), " failed: the toy is broken; mend it")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--planner", "drawn"], ["ours"]),
        (["--worlds", "generated:1,generated:1"], ["two worlds"]),
        (["--methods", "dwa,dwa"], ["two methods"]),
        (["--methods", "no_such_module:Mine"], ["no_such_module"]),
        (["--methods", "a b.json"], ["letters"]),
        (["--out", "/proc/nowhere"], ["/proc/nowhere"]),
    ],
)
def test_mistakes_are_one_line(tmp_path, capsys, arguments, words):
    # Options that come twice count the second time.
    usual_options = ["--out", str(tmp_path / "o"), "--worlds", "generated:0", "--methods", "dwa"]
    assert evaluate.main([*usual_options, *arguments]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert error.startswith("./applr evaluate: ")
    for word in words:
        assert word in error, error
    assert not (tmp_path / "o" / "trials.csv").exists()


# -- methods ---------------------------------------------------------------------------------------
CONTEXT = methods.Context(
    ranges=np.full(720, 2.0, np.float32),
    phi=0.0,
    theta=SPACE.theta0,
    time=0.0,
)


def test_a_method_from_a_users_class(tmp_path, monkeypatch):
    (tmp_path / "my_module.py").write_text(MY_MODULE)
    monkeypatch.syspath_prepend(str(tmp_path))
    method = methods.make("my_module:Cautious")
    method.reset(3)
    assert method.theta(CONTEXT)[SPACE.names.index("max_vel_x")] == 0.7
    assert method.seed == 3
    with pytest.raises(ApplrError, match="not a subclass"):
        methods.make("my_module:Nothing")
    problem = "method my_module:Cautios: my_module has no class Cautios: give Cautious$"
    with pytest.raises(ApplrError, match=problem):
        methods.make("my_module:Cautios")
    file = tmp_path / "empty.py"
    file.write_text("from applr_ros1.policy.methods import Method\n")
    problem = r"empty.py has no class Any: derive one from .*\.Method$"
    with pytest.raises(ApplrError, match=problem):
        methods.make(f"{file}:Any")
    assert methods.parse("dwa,my_module:Cautious") == [
        ("dwa", "dwa"),
        ("Cautious", "my_module:Cautious"),
    ]


def test_a_finished_evaluation_needs_no_workers(tmp_path, monkeypatch):
    options = {"worlds": "generated:0", "trials": 1, "out": str(tmp_path)}
    monkeypatch.setattr("training.evaluate.evaluation.run", runs.draw_result)
    finished = evaluate_all(EvaluationOptions(**options, methods="dwa,random", workers=0))
    # Nobody listens there.
    on_cluster = {**options, "workers": 8, "ray_address": "127.0.0.1:1"}
    again = evaluate_all(EvaluationOptions(**on_cluster, methods="dwa,random"))
    assert repr(again) == repr(finished)
    # The rows have the order of the latest plan.
    evaluate_all(EvaluationOptions(**on_cluster, methods="random,dwa"))
    assert read_trials(tmp_path / "trials.csv").method.tolist() == ["random", "dwa"]


# -- the real stack --------------------------------------------------------------------------------
@pytest.mark.heavy
def test_trial_depends_on_its_task_only():
    """A trial driven first, or after another world and method, has the same result to the last
    digit.
    """
    task = Trial("generated:19", "m", 0, 11, "generated:19", "static")
    first_result = runner.TrialRunner(TrialSettings()).run(task)

    # The other trial lasts 6 s only, to save time.
    used_runner = runner.TrialRunner(TrialSettings())
    used_runner.rules = Rules(limit=6.0)
    other_task = replace(
        task,
        world="generated:64",
        world_spec="generated:64",
        method_spec="random",
        seed=3,
    )
    used_runner.run(other_task)
    used_runner.rules = Rules()
    assert used_runner.run(task) == first_result

    # The same set as numbers, as from a search
    theta = tuple(methods.make("static").theta(CONTEXT))
    assert used_runner.run(replace(task, theta=theta)) == first_result


def test_traces_are_stored_beside_the_table(tmp_path):
    drive = driven(
        [0.0, 0.05],
        [(0, 0, 0), (1, 0, 0)],
        theta=[np.zeros(11)],
        decided=[0.0],
    )
    plan = plan_trials([("generated:0", "generated:0")], [("dwa", "dwa")], 1, seed=0)
    with TrialTable(tmp_path, {"worlds": ["generated:0"]}) as table:
        with pytest.raises(ApplrError, match="another"):
            TrialTable(tmp_path, {"worlds": ["generated:0"]})
        table.add(plan[0], Result(time_s=1.0), drive.pack())
    assert read_trace(tmp_path, "generated:0", "dwa", 0).truth.pose.shape == (2, 3)
    assert read_trace(tmp_path, "generated:0", "dwa", 1) is None
