"""Tests of the wheel: its packages, data and program."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Callable, NamedTuple

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


class Installed(NamedTuple):
    """Folder of an installation by pip, its program, and a function that runs a command line with
    it.
    """

    folder: Path
    program: Path
    run: Callable[..., str]


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Install a wheel of the clone for all tests of this file."""
    source = tmp_path_factory.mktemp("source")
    target = tmp_path_factory.mktemp("target")
    # In the clone's folder, Python would import the clone.
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    # pip would leave its files of building in the clone. Other tests write bytecode meanwhile.
    without_caches = shutil.ignore_patterns("__pycache__")
    for package in PACKAGES:
        shutil.copytree(ROOT / package, source / package, ignore=without_caches)
    for file_name in ("setup.py", "pyproject.toml", "package.xml", "README.md"):
        shutil.copy(ROOT / file_name, source)
    run(*PIP, target, source)
    environment = {**os.environ, "PYTHONPATH": str(target)}

    def run_there(*words):
        return run(*words, cwd=elsewhere, env=environment)

    return Installed(target, target / "bin" / "applr-ros1", run_there)


@pytest.mark.slow
def test_a_wheel_has_the_packages_of_the_clone_with_their_data(installed):
    installed_names = set()
    for path in installed.folder.iterdir():
        if path.suffix != ".dist-info":
            installed_names.add(path.name)
    assert installed_names == {*PACKAGES, "bin"}
    for data_file in (
        "worlds/data/builtin.npz",
        "worlds/data/physical_course.world",
        "training/train/recipes/jackal.yaml",
        "training/why/why.js",
        "applr_ros1/common/pages/page.css",
    ):
        assert (installed.folder / data_file).is_file()


@pytest.mark.slow
def test_the_program_prints_names_and_version(installed):
    version = xml.parse(ROOT / "package.xml").findtext("version")
    assert installed.run(installed.program, "--version") == f"applr_ros1 {version}\n"
    prints_version = "import applr_ros1; print(applr_ros1.__version__)"
    assert installed.run(sys.executable, "-c", prints_version) == version + "\n"
    assert applr_ros1.__version__ == version
    assert "evaluate" in installed.run(installed.program)
    misspelt = subprocess.run(
        [installed.program, "evalute"], capture_output=True, text=True, env=os.environ
    )
    assert misspelt.returncode == 1


@pytest.mark.slow
def test_a_wheel_evaluates_and_trains_with_workers(installed, tmp_path):
    world_options = ("--worlds", "generated:7", "--simulator", "kinematic")

    results = tmp_path / "results"
    one_trial = ("--workers", 1, "--methods", "dwa", "--trials", 1, "--out", results)
    installed.run(installed.program, "evaluate", *world_options, *one_trial)
    assert "generated:7,dwa" in (results / "trials.csv").read_text()

    run_folder = tmp_path / "run"
    training_options = ("--total-timesteps", 12, "--learning-starts", 8, "--batch-size", 4)
    training_options += ("--actors", 0, "--eval-worlds", "none", "--out", run_folder)
    installed.run(sys.executable, "-m", "training.train", *world_options, *training_options)
    assert (run_folder / "actor.safetensors").is_file()
    assert json.loads((run_folder / "config.json").read_text())["simulator"] == "kinematic"

    prints_environment = (
        "import gymnasium; print(gymnasium.make('training.env:applr_ros1/Navigation-v0').unwrapped)"
    )
    environment = installed.run(sys.executable, "-c", prints_environment)
    assert environment == "<ApplrEnv<applr_ros1/Navigation-v0>>\n"
