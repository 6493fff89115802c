"""Tests that each example runs as its page describes, with fewer steps, and writes its output
files.
"""

import csv
import re
import runpy
import shutil
import sys

import numpy as np
import pytest
import stable_baselines3
import torch
from safetensors.numpy import save_file

from applr_ros1.policy import methods
from applr_ros1.policy.actor import load
from applr_ros1.policy.decision import Context
from applr_ros1.policy.parameter_space import SPACE
from tests.support import ROOT
from training.evaluate import __main__ as evaluate

EXAMPLES = sorted(path.name for path in (ROOT / "examples").iterdir() if path.is_dir())
# Packages that the examples need besides this package.
LIBRARIES = (stable_baselines3, torch)


def test_the_page_lists_all_examples():
    readme = (ROOT / "examples" / "README.md").read_text()
    assert re.findall(r"^\| `(\w+)` \|", readme, re.MULTILINE) == EXAMPLES


@pytest.mark.slow
def test_foreign_learner(tmp_path, monkeypatch, capsys):
    program = str(ROOT / "examples" / "01_foreign_learner" / "run.py")
    monkeypatch.chdir(tmp_path)
    # So few steps that the policy learns nothing: whether it arrives does not matter here.
    monkeypatch.setattr(sys, "argv", [program, "--steps", "60", "--out", "a.safetensors"])
    runpy.run_path(program, run_name="__main__")
    last_line = capsys.readouterr().out.splitlines()[-1]
    assert re.match(r"a.safetensors: (goal reached|not reached) after \d+", last_line)
    assert load(tmp_path / "a.safetensors").metadata["training"]["learner"] == "stable-baselines3"


@pytest.mark.heavy
def test_own_method(tmp_path):
    names = f"dwa,{ROOT}/examples/02_own_method/cautious.py:Cautious"
    options = ["--worlds=generated:1", "--trials=1", "--methods", names, "--out", str(tmp_path)]
    # In this process: workers would spend most of the time on their imports.
    assert evaluate.main([*options, "--workers=0"]) == 0
    dwa_trial, own_trial = csv.DictReader((tmp_path / "trials.csv").read_text().splitlines())
    assert (dwa_trial["success"], own_trial["success"]) == ("True", "True")
    assert float(own_trial["time_s"]) < float(dwa_trial["time_s"])


def test_a_network_of_another_project_sets_its_parameters(tmp_path):
    shutil.copy(ROOT / "examples" / "02_own_method" / "network.py", tmp_path)
    # Given: a layer for 720 ranges and an angle, whose negative output does not pass ReLU, and one
    # whose outputs are the middle and the upper end
    layers = {
        "0.weight": np.zeros((2, 721), np.float32),
        "0.bias": np.array([-5.0, 20.0], np.float32),
        "1.weight": np.eye(2, dtype=np.float32),
        "1.bias": np.zeros(2, np.float32),
    }
    save_file(layers, tmp_path / "actor.safetensors")
    method = methods.make(f"{tmp_path}/network.py:ForeignNetwork")
    scan = np.full(720, 5.0, np.float32)
    theta = method.theta(Context(ranges=scan, phi=0.0, theta=SPACE.theta0, time=0.0))
    parameters = SPACE.as_dict(theta)
    assert parameters["max_vel_x"] == pytest.approx(1.1)
    assert parameters["inflation_radius"] == pytest.approx(0.6)
    assert parameters["vx_samples"] == SPACE.as_dict(SPACE.theta0)["vx_samples"]
