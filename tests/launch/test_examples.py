"""Examples: each runs as its page describes, with fewer steps, and writes its output files."""

import csv
import importlib
import re
import runpy
import subprocess
import sys

import pytest
import stable_baselines3
import torch

from applr_ros1.policy.actor import load
from tests.support import ROOT
from training import evaluate

EXAMPLES = sorted(path.name for path in (ROOT / "examples").iterdir() if path.is_dir())
LIBRARIES = (stable_baselines3, torch)  # packages that the examples need besides this package


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Return run(name, arguments), which runs an example in an empty folder and returns its printed lines.

    The example and the commands of this package that it starts (`python -m MODULE`) run in this process.
    """
    started = subprocess.run

    def command(words, **more):
        if words[:2] != [sys.executable, "-m"]:
            return started(words, **more)
        assert more == {"check": True}, "the example ignores failures of its commands"
        assert importlib.import_module(words[2]).main(words[3:]) == 0, capsys.readouterr().err
        return None

    def run(name, *arguments):
        path = ROOT / "examples" / name / "run.py"
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", [str(path), *map(str, arguments)])
        capsys.readouterr()
        with monkeypatch.context() as patch:
            patch.setattr(subprocess, "run", command)
            runpy.run_path(str(path), run_name="__main__")
        return capsys.readouterr().out.splitlines()

    return run


def test_the_page_lists_all_examples():
    listed = re.findall(r"^\| `(\w+)` \|", (ROOT / "examples" / "README.md").read_text(), re.MULTILINE)
    assert listed == EXAMPLES


def test_foreign_learner(tmp_path, run):
    lines = run("01_foreign_learner", "--steps", 60, "--out", "a.safetensors")
    assert re.match(r"a.safetensors: (goal reached|not reached) after \d+", lines[-1])
    assert load(tmp_path / "a.safetensors").metadata["training"]["learner"] == "stable-baselines3"


def test_own_method(tmp_path):
    methods = f"dwa,{ROOT}/examples/02_own_method/cautious.py:Cautious"
    assert evaluate.main(["--worlds=generated:7", "--trials=1", "--methods", methods, "--out", str(tmp_path)]) == 0
    dwa, cautious = csv.DictReader((tmp_path / "trials.csv").read_text().splitlines())
    assert (dwa["success"], cautious["success"]) == ("True", "True")
    assert float(cautious["time_s"]) < float(dwa["time_s"])


def test_offline_from_a_bag(tmp_path, run):
    options = "--gradient-steps", 5, "--net-arch", 16, 16, "--out"
    run("03_offline_from_a_bag", *options, "recorded")
    run("03_offline_from_a_bag", tmp_path / "recorded" / "drives.bag", *options, "given")
    for name in ("recorded", "given"):
        assert load(tmp_path / name / "run" / "actor.safetensors")
