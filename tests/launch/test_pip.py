"""Tests of the wheel: its packages, data and program."""

import json
import os
import shutil
import subprocess
import sys

import pytest

import applr_ros1
from tests.support import HANGS, ROOT
from tests.test_project import xml

PACKAGES = ("applr_ros1", "sim_bridge", "training", "worlds")
# Installation into a folder, without network: the packages that it needs are here already.
OFFLINE = ("--no-deps", "--no-index", "--no-build-isolation")
PIP = (sys.executable, "-m", "pip", "install", "-q", *OFFLINE, "--target")


def run(*words, **options):
    """Run a command, and return its output."""
    finished = subprocess.run(
        list(map(str, words)), capture_output=True, text=True, timeout=HANGS, **options
    )
    assert finished.returncode == 0, finished.stdout[-2000:] + finished.stderr[-2000:]
    return finished.stdout


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Return (folder of an installation by pip, function that runs a program there)."""
    source = tmp_path_factory.mktemp("source")
    target = tmp_path_factory.mktemp("target")
    # In the clone's folder, Python would import the clone.
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    for name in PACKAGES:
        shutil.copytree(ROOT / name, source / name)
    for name in ("setup.py", "pyproject.toml", "package.xml", "README.md"):
        shutil.copy(ROOT / name, source)
    run(*PIP, target, source)
    environment = {**os.environ, "PYTHONPATH": str(target)}
    return target, lambda *words: run(*words, cwd=elsewhere, env=environment)


def test_a_wheel_has_the_packages_of_the_clone_with_their_data(installed):
    folder, _ = installed
    names = {path.name for path in folder.iterdir() if path.suffix != ".dist-info"}
    assert names == {*PACKAGES, "bin"}
    for data in (
        "worlds/data/builtin.npz",
        "training/train/recipes/jackal.yaml",
        "training/why/why.js",
        "applr_ros1/common/pages/page.css",
    ):
        assert (folder / data).is_file()


def test_the_program_prints_names_and_version(installed):
    folder, elsewhere = installed
    version = xml.parse(ROOT / "package.xml").findtext("version")
    assert elsewhere(folder / "bin" / "applr-ros1", "--version") == f"applr_ros1 {version}\n"
    code = "import applr_ros1; print(applr_ros1.__version__)"
    assert elsewhere(sys.executable, "-c", code) == version + "\n"
    assert applr_ros1.__version__ == version
    assert "evaluate" in elsewhere(folder / "bin" / "applr-ros1")
    unknown = subprocess.run(
        [folder / "bin" / "applr-ros1", "evalute"], capture_output=True, text=True, env=os.environ
    )
    assert unknown.returncode == 1


@pytest.mark.slow
def test_a_wheel_evaluates_and_trains_with_workers(installed, tmp_path):
    folder, elsewhere = installed
    drive = ("--worlds", "generated:7", "--simulator", "kinematic")
    out = ("--workers", 1, "--methods", "dwa", "--trials", 1, "--out", tmp_path / "results")
    elsewhere(folder / "bin" / "applr-ros1", "evaluate", *drive, *out)
    assert "generated:7,dwa" in (tmp_path / "results" / "trials.csv").read_text()
    steps = ("--total-timesteps", 12, "--learning-starts", 8, "--batch-size", 4)
    steps += ("--actors", 0, "--eval-worlds", "none")
    elsewhere(sys.executable, "-m", "training.train", *drive, *steps, "--out", tmp_path / "run")
    assert (tmp_path / "run" / "actor.safetensors").is_file()
    assert json.loads((tmp_path / "run" / "config.json").read_text())["simulator"] == "kinematic"
    ask = (
        "import gymnasium; print(gymnasium.make('training.env:applr_ros1/Navigation-v0').unwrapped)"
    )
    assert elsewhere(sys.executable, "-c", ask) == "<ApplrEnv<applr_ros1/Navigation-v0>>\n"
