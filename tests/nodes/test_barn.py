"""./applr barn: a runner that makes the calls of the BARN Challenge's, in a made-up checkout; results and scores."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import psutil
import pytest
import rospkg  # noqa: F401 - the runner needs it: without ROS this file is left out
import rospy  # noqa: F401

from applr_ros1.common.errors import ApplrError
from applr_ros1.nodes.tools import barn
from tests.support import HANGS, ROOT
from tests.support.refusals import refused
from tests.support.worlds_sdf import as_barn, moving, sdf
from worlds import dynabarn, load
from worlds.barn import fields

pytestmark = pytest.mark.ros


@pytest.fixture
def checkout(tmp_path):
    """run.py and jackal_helper as in the Challenge's repository: world 2 of BARN's kind, world 300 of DynaBARN's."""
    root = tmp_path / "checkout"
    helper = root / "jackal_helper"
    static, dynamic = helper / "worlds" / "BARN", helper / "worlds" / "DynaBARN"
    for folder in (static / "path_files", dynamic, helper / "launch", helper / "plugins"):
        folder.mkdir(parents=True)
    shutil.copy(ROOT / "tests" / "support" / "barn_runner.py", root / "run.py")
    shutil.copy(ROOT / "tests" / "support" / "gazebo_client.py", root)
    shutil.copy(ROOT / "compat" / "jackal_helper" / "package.xml", helper)
    shutil.copy(ROOT / "compat" / "jackal_helper" / "launch" / "move_base_DWA.launch", helper / "launch")
    (helper / "launch" / "gazebo_launch.launch").write_text("<launch><!-- starts Gazebo --></launch>")
    (static / "world_2.world").write_text(as_barn(load("generated:2")))
    np.save(static / "path_files" / "path_2.npy", fields()[2][1])
    (dynamic / "world_0.world").write_text(sdf(moving("easylibobs_1")))
    rows = dynabarn.COLUMNS, ("easylibobs_1", "10", "1", "0", "-5", "7"), ("easylibobs_1", "10", "1", "10", "5", "7")
    (dynamic / dynabarn.NAME).write_text("\n".join(map(",".join, rows)))
    return root


def command(*arguments, **environment):
    return subprocess.run(
        [sys.executable, "-m", "applr_ros1.scripts", "barn", *map(str, arguments)],
        env=dict(os.environ, PYTHONPATH=os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]), **environment),
        capture_output=True,
        text=True,
        timeout=HANGS,
    )


def left_over(word):
    """Command lines of living processes that hold a word."""
    lines = [" ".join(process.info["cmdline"] or ()) for process in psutil.process_iter(["cmdline"])]
    return [line for line in lines if word in line]


@pytest.mark.parametrize("worlds", [(2,), pytest.param((2, 300), marks=pytest.mark.slow)], ids=str)
def test_runs_the_runner_and_goes_on_where_it_stopped(checkout, tmp_path, worlds):
    out = tmp_path / "results"
    options = ["--out", out, "--simulator", "kinematic", "--real-time-factor", "2", "--jobs", "2"]
    options += ["--controller", ROOT / "applr_ros1" / "launch" / "barn_controller.launch"]
    driven = "--worlds", ",".join(map(str, worlds))
    done = command(checkout, *driven, *options)
    assert done.returncode == 0, done.stdout + done.stderr
    lines = sorted((out / "out.txt").read_text().splitlines())
    assert [int(line.split()[0]) for line in lines] == list(worlds)
    found = json.loads(done.stdout.splitlines()[-1])
    assert found == json.loads((out / "summary.json").read_text())
    assert found["runs"] == found["worlds"] == len(worlds)
    assert found["success_rate"] == 1.0, (out / "runs.csv").read_text()
    assert found["score"] == pytest.approx(found["metric_of_runner"], abs=2e-3)  # computed here and by the runner
    assert 0.1 < found["score"] <= 0.5
    assert not left_over(str(checkout))
    again = command(checkout, *driven, *options)
    assert again.returncode == 0
    assert f"0 runs to do, {len(worlds)} done before" in again.stdout
    refused(lambda: evaluation(checkout, out, "--simulator", "pybullet"), "give another --out")


def test_a_controller_of_ones_own_and_a_runner_that_fails(checkout, tmp_path):
    launch = tmp_path / "mine.launch"
    launch.write_text("<launch/>")
    barn.Overlay(checkout, tmp_path / "overlay", launch)
    with pytest.raises(ApplrError, match=r"no checkout of the BARN Challenge: it has no run\.py"):
        barn.Overlay(tmp_path, tmp_path / "other", None)
    linked = tmp_path / "overlay" / "jackal_helper" / "launch" / "move_base_DWA.launch"
    assert linked.resolve() == launch
    world = Path("jackal_helper", "worlds", "BARN", "world_2.world")
    assert (tmp_path / "overlay" / world).resolve() == checkout / world
    (checkout / "run.py").write_text("raise SystemExit('no gazebo here')")
    done = command(checkout, "--worlds", "2", "--out", tmp_path / "results")
    assert done.returncode == 1
    assert "not driven: the runner ended with status 1: no gazebo here" in done.stdout
    assert "1 of 1 runs could not be driven" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--worlds", "9-3"], "give numbers from 0 to 359"),
        (["--worlds", "7"], "no world 7"),
        (["--controller", "none.launch"], "none.launch is not there"),
        (["--real-time-factor", "nan"], "--real-time-factor nan"),
    ],
)
def test_mistakes_are_one_line(checkout, tmp_path, arguments, words):
    options = barn.parser().parse_args([str(checkout), "--out", str(tmp_path / "results"), *arguments])
    refused(lambda: barn.Evaluation(options), words)


def test_two_methods_do_not_share_a_folder(checkout, tmp_path, monkeypatch):
    """What the environment gives to a controller of this package is a setting; its files are taken from here."""
    options = barn.parser().parse_args([str(checkout), "--out", str(tmp_path / "results"), "--worlds", "2"])
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("APPLR_METHOD", "mine.safetensors")
    assert barn.Evaluation(options).method == str(tmp_path / "mine.safetensors")
    monkeypatch.setenv("APPLR_METHOD", "dwa")
    refused(lambda: barn.Evaluation(options), "holds runs with APPLR_METHOD .*mine.safetensors, not dwa: give anothe")


def test_scores_of_the_challenge():
    """By hand: optimal time 5 s; half marks at twice that and below, least at the clip, nothing without success."""
    score = barn.score
    assert score(True, 3.0, 5.0, 2.0) == 0.5
    assert score(True, 3.0, 5.0, 4.0) == 0.25
    assert score(True, 20.0, 5.0, 2.0) == 0.25
    assert score(True, 25.0, 5.0, 4.0) == 0.2
    assert score(True, 90.0, 5.0, 2.0) == score(True, 90.0, 5.0, 4.0) == 0.125
    assert score(False, 3.0, 5.0, 2.0) == 0.0


def evaluation(checkout, out, *arguments):
    return barn.Evaluation(barn.parser().parse_args([str(checkout), "--out", str(out), "--worlds", "2", *arguments]))


def test_runs_without_a_whole_line_are_driven_again(checkout, tmp_path):
    found = evaluation(checkout, tmp_path / "out", "--trials", "4")
    for trial, text in enumerate(("2 1 0 0 12.5000 0.4000\n", "2 1 0", "7 1 0 0 12.5000 0.4000\n")):
        (tmp_path / "out" / "logs" / ("world_2_trial_%d.out" % trial)).write_text(text)
    assert list(found.done()) == [(2, 0)]
    assert found.done()[2, 0] == barn.run_of("2 1 0 0 12.5000 0.4000", 0, found.routes[2])
    found.write()
    header, *rows = (tmp_path / "out" / "runs.csv").read_text().splitlines()
    assert header.startswith("world,trial,success,collided,timeout,time_s,metric,score,")
    assert [row.split(",")[:3] for row in rows] == [["2", "0", "1"]]
    assert (tmp_path / "out" / "out.txt").read_text() == "2 1 0 0 12.5000 0.4000\n"
