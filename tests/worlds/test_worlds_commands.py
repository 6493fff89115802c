"""The commands of worlds/: each does its work, and a user's mistake is one line and a non-zero exit status."""

import subprocess
import sys

import pytest

import worlds
from tests.support import ROOT


def run(*arguments):
    command = [sys.executable, "-m"] + [str(a) for a in arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True)


def test_draw(tmp_path):
    done = run("worlds.draw", "physical_course", tmp_path / "out.png")
    assert done.returncode == 0
    assert (tmp_path / "out.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize("out", ["/nowhere/out.png", "out.nonsense"])
def test_draw_mistakes(out):
    done = run("worlds.draw", "generated:7", out)
    assert done.returncode == 1
    assert done.stderr.startswith("draw: ")
    assert done.stderr.count("\n") == 1


def test_write(tmp_path):
    assert run("worlds.sdf_writer", "generated:7", tmp_path / "w.world").returncode == 0
    assert len(worlds.load(str(tmp_path / "w.world")).cylinders) == len(worlds.load("generated:7").cylinders)
    done = run("worlds.sdf_writer", "generated:7", "/nowhere/w.world")
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
