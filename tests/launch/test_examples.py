"""Tests that each example runs as its page describes, with fewer steps, and writes its output
files.
"""

import csv
import re
import runpy
import sys

import stable_baselines3
import torch

from applr_ros1.policy.actor import load
from tests.support import ROOT
from training.evaluate import __main__ as evaluate

EXAMPLES = sorted(path.name for path in (ROOT / "examples").iterdir() if path.is_dir())
# Packages that the examples need besides this package.
LIBRARIES = (stable_baselines3, torch)


def test_the_page_lists_all_examples():
    readme = (ROOT / "examples" / "README.md").read_text()
    assert re.findall(r"^\| `(\w+)` \|", readme, re.MULTILINE) == EXAMPLES


def test_foreign_learner(tmp_path, monkeypatch, capsys):
    program = str(ROOT / "examples" / "01_foreign_learner" / "run.py")
    monkeypatch.chdir(tmp_path)
    # So few steps that the policy learns nothing: whether it arrives does not matter here.
    monkeypatch.setattr(sys, "argv", [program, "--steps", "60", "--out", "a.safetensors"])
    runpy.run_path(program, run_name="__main__")
    last_line = capsys.readouterr().out.splitlines()[-1]
    assert re.match(r"a.safetensors: (goal reached|not reached) after \d+", last_line)
    assert load(tmp_path / "a.safetensors").metadata["training"]["learner"] == "stable-baselines3"


def test_own_method(tmp_path):
    methods = f"dwa,{ROOT}/examples/02_own_method/cautious.py:Cautious"
    options = ["--worlds=generated:7", "--trials=1", "--methods", methods, "--out", str(tmp_path)]
    assert evaluate.main(options) == 0
    dwa_trial, own_trial = csv.DictReader((tmp_path / "trials.csv").read_text().splitlines())
    assert (dwa_trial["success"], own_trial["success"]) == ("True", "True")
    assert float(own_trial["time_s"]) < float(dwa_trial["time_s"])
