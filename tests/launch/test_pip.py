"""Tests of the wheel: one top-level package without name collisions, its program, and equal names in a clone."""

import ast
import json
import os
import shutil
import subprocess
import sys

import pytest

import applr_ros1
from tests.support import HANGS, ROOT
from tests.test_project import xml

BESIDE = ("sim_bridge", "training", "worlds")
PIP = (sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-index", "--no-build-isolation", "--target")


def run(*words, **options):
    done = subprocess.run(list(map(str, words)), capture_output=True, text=True, timeout=HANGS, **options)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return done.stdout


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Return (folder of an installation by pip, function that runs a program there among packages of equal names)."""
    source, target, elsewhere = (tmp_path_factory.mktemp(name) for name in ("source", "target", "elsewhere"))
    for name in ("applr_ros1", *BESIDE):
        shutil.copytree(ROOT / name, source / name)
    for name in ("setup.py", "pyproject.toml", "package.xml", "README.md"):
        shutil.copy(ROOT / name, source)
    run(*PIP, target, source)
    for name in BESIDE:
        (elsewhere / name).mkdir()
        (elsewhere / name / "__init__.py").write_text("raise SystemExit('another package of this name')")
    environment = {**os.environ, "PYTHONPATH": str(target)}
    return target, lambda *words: run(*words, cwd=elsewhere, env=environment)


def test_a_wheel_has_one_package_whose_imports_are_its_own(installed):
    folder, _ = installed
    assert {path.name for path in folder.iterdir() if path.suffix != ".dist-info"} == {"applr_ros1", "bin"}
    assert (folder / "applr_ros1" / "worlds" / "data" / "builtin.npz").is_file()
    for path in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and not node.level:
                names.append(node.module)
            assert not [name for name in names if name.startswith(BESIDE)], path


def test_the_program_prints_names_and_version(installed):
    folder, elsewhere = installed
    version = xml.parse(ROOT / "package.xml").findtext("version")
    assert elsewhere(folder / "bin" / "applr-ros1", "--version") == f"applr_ros1 {version}\n"
    assert elsewhere(sys.executable, "-c", "import applr_ros1; print(applr_ros1.__version__)") == version + "\n"
    assert applr_ros1.__version__ == version
    assert "evaluate" in elsewhere(folder / "bin" / "applr-ros1")
    unknown = subprocess.run([folder / "bin" / "applr-ros1", "evalute"], capture_output=True, text=True, env=os.environ)
    assert unknown.returncode == 1


@pytest.mark.slow
def test_a_wheel_evaluates_and_trains_with_workers_beside_packages_of_the_same_names(installed, tmp_path):
    folder, elsewhere = installed
    drive = ("--worlds", "generated:7", "--simulator", "kinematic")
    out = ("--workers", 1, "--methods", "dwa", "--trials", 1, "--out", tmp_path / "results")
    elsewhere(folder / "bin" / "applr-ros1", "evaluate", *drive, *out)
    assert "generated:7,dwa" in (tmp_path / "results" / "trials.csv").read_text()
    steps = ("--total-timesteps", 12, "--learning-starts", 8, "--batch-size", 4, "--actors", 0, "--eval-worlds", "none")
    elsewhere(sys.executable, "-m", "applr_ros1.training.train", *drive, *steps, "--out", tmp_path / "run")
    assert (tmp_path / "run" / "actor.safetensors").is_file()
    assert json.loads((tmp_path / "run" / "config.json").read_text())["simulator"] == "kinematic"
    ask = "import gymnasium; print(gymnasium.make('applr_ros1.training.env:applr_ros1/Navigation-v0').unwrapped)"
    assert elsewhere(sys.executable, "-c", ask) == "<ApplrEnv<applr_ros1/Navigation-v0>>\n"


def test_in_a_clone_both_names_are_one_module():
    import applr_ros1.training.env.env as below

    import training.env.env as beside
    from applr_ros1 import worlds

    assert below is beside
    assert beside.__spec__.name == beside.__name__ == "training.env.env"
    assert worlds is sys.modules["worlds"]
    assert "usage" in run(sys.executable, "-m", "applr_ros1.training.evaluate", "--help", cwd=ROOT)
    with pytest.raises(ModuleNotFoundError, match="applr_ros1.training.none"):
        import applr_ros1.training.none  # noqa: F401
