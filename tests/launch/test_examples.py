"""Every example runs as its page says, only shorter, and leaves what it promises."""

import os
import re
import subprocess
import sys

import pytest
import stable_baselines3
import torch
from PIL import Image

from applr_ros1.policy.actor import load
from tests.support import ROOT

EXAMPLES = sorted(path.name for path in (ROOT / "examples").iterdir() if path.is_dir())
LIBRARIES = (stable_baselines3, torch)  # what they need beside the package


def run(name, folder, *arguments):
    """The lines that the example prints, started in an empty folder."""
    command = [sys.executable, str(ROOT / "examples" / name / "run.py"), *map(str, arguments)]
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout.splitlines()


def test_the_page_lists_all_of_them():
    listed = re.findall(r"^\| `(\w+)` \|", (ROOT / "examples" / "README.md").read_text(), re.MULTILINE)
    assert listed == EXAMPLES


def test_foreign_learner(tmp_path):
    lines = run("01_foreign_learner", tmp_path, "--steps", 60, "--out", "a.safetensors")
    assert re.match(r"a.safetensors: (goal reached|not reached) after \d+", lines[-1])
    assert load(tmp_path / "a.safetensors").metadata["training"]["learner"] == "stable-baselines3"


def test_own_method(tmp_path):
    lines = run("02_own_method", tmp_path, "--worlds", "generated:7", "--trials", 1, "--out", "out")
    times = {line.split()[0]: float(line.split()[-2]) for line in lines if " trial 0: goal after " in line}
    assert times["cautious"] < times["dwa"]
    assert (tmp_path / "out" / "report" / "index.html").exists()


def test_offline_from_a_bag(tmp_path):
    arguments = ("--courses", 2, "--decisions", 4, "--gradient-steps", 5, "--net-arch", 16, 16, "--out", "out")
    run("03_offline_from_a_bag", tmp_path, *arguments)
    assert load(tmp_path / "out" / "run" / "actor.safetensors")


def test_own_reward(tmp_path):
    lines = run("04_own_reward", tmp_path, "--decisions", 4)
    rows = {line.split()[0]: line.split()[1:] for line in lines}
    standard, ours = map(float, rows["total"])
    none, hurry = rows["hurry"]
    assert none == "-"
    assert ours == pytest.approx(standard + float(hurry), abs=0.02)
    assert float(hurry) < 0.0


def test_reading_a_trace(tmp_path):
    lines = run("05_reading_a_trace", tmp_path, "--methods", "dwa", "--out", "out")
    metres, seconds = map(float, re.match(r"dwa: ([\d.]+) m in ([\d.]+) s", lines[-2]).groups())
    assert 5.0 < metres < 20.0
    assert seconds > 10.0
    assert (tmp_path / "out" / "trace.png").stat().st_size > 5000


def test_side_by_side(tmp_path):
    run("08_side_by_side", tmp_path, "--out", "out.gif")
    with Image.open(tmp_path / "out.gif") as animation:
        assert animation.n_frames > 100
