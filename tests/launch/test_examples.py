"""Every example runs as its page says, only shorter, and leaves what it promises."""

import os
import re
import subprocess
import sys

import stable_baselines3
import torch

from applr_ros1.policy.actor import load
from tests.support import HANGS, ROOT

EXAMPLES = sorted(path.name for path in (ROOT / "examples").iterdir() if path.is_dir())
LIBRARIES = (stable_baselines3, torch)  # what they need beside the package


def run(name, folder, *arguments):
    """The lines that the example prints, started in an empty folder."""
    command = [sys.executable, str(ROOT / "examples" / name / "run.py"), *map(str, arguments)]
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=HANGS, check=False
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
    options = "--gradient-steps", 5, "--net-arch", 16, 16, "--out"
    run("03_offline_from_a_bag", tmp_path, *options, "recorded")
    run("03_offline_from_a_bag", tmp_path, tmp_path / "recorded" / "drives.bag", *options, "given")
    for name in ("recorded", "given"):
        assert load(tmp_path / name / "run" / "actor.safetensors")
