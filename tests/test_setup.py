"""./applr when something is missing: one clear line and a non-zero exit, before anything is changed. The script runs
from a copy in another folder, with stand-ins for the system's programs first on PATH; nothing is installed.
"""

import os
import shutil
import subprocess
import sys

import pytest

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))


@pytest.fixture
def clone(tmp_path):
    """A folder with what set-up reads, and a function that runs ./applr there with stand-in programs."""
    for name in ("applr", "CMakeLists.txt", "package.xml", "setup.py"):
        shutil.copy2(os.path.join(ROOT, name), tmp_path / name)
    for name in ("requirements", "applr_ros1/cfg", "applr_ros1/planner", "applr_ros1/scripts"):
        shutil.copytree(os.path.join(ROOT, name), tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    programs = tmp_path / "stand-ins"
    programs.mkdir()

    def run(*words, stand_ins=None, **environment):
        for name, body in (stand_ins or {}).items():
            (programs / name).write_text("#!/bin/sh\n" + body + "\n")
            (programs / name).chmod(0o755)
        environment = dict(os.environ, PATH="%s:/usr/bin:/bin" % programs, **environment)
        done = subprocess.run(
            [str(tmp_path / "applr"), *words], env=environment, capture_output=True, text=True, timeout=120, check=False
        )
        return done.returncode, done.stderr.strip().splitlines()

    run.programs = programs
    return run


NOTHING = {"dpkg-query": "exit 1"}
ALL = {"dpkg-query": 'shift 3; for p in "$@"; do echo installed $p; done'}


def test_help_and_wrong_commands(clone):
    assert clone("--help") == (0, [])
    code, lines = clone("dance")
    assert code == 1
    assert len(lines) == 1
    assert "dance" in lines[0]
    assert "setup" in lines[0]


def test_without_root_the_missing_packages_are_named(clone):
    code, lines = clone("setup", stand_ins=dict(NOTHING, id="echo 1000", sudo="exit 1"))
    assert code == 1
    assert len(lines) == 1
    assert "apt-get install" in lines[0]
    assert "python3-rospy" in lines[0] or "ros-noetic-rospy" in lines[0]


def test_without_network_apt_says_so(clone):
    code, lines = clone(
        "setup",
        stand_ins=dict(NOTHING, id="echo 0", **{"apt-get": "echo 'E: Unable to fetch some archives' >&2; exit 100"}),
    )
    assert code == 1
    assert "network" in lines[-1]
    assert "Unable to fetch" in lines[-1]
    assert all(line.startswith("applr: ") for line in lines)


@pytest.mark.parametrize("version", ["2.7", "3.7"])
def test_an_old_python_is_refused(clone, version):
    old = {"old-python": "echo " + version}
    code, lines = clone("setup", stand_ins=old, APPLR_PYTHON=str(clone.programs / "old-python"))
    assert code == 1
    assert len(lines) == 1
    assert version in lines[0]
    assert "3.8 or later" in lines[0]


def test_no_python_is_refused(clone):
    code, lines = clone("setup", APPLR_PYTHON="/no/such/python")
    assert code == 1
    assert len(lines) == 1
    assert "/no/such/python" in lines[0]


@pytest.mark.parametrize("root", [True, False])
def test_a_missing_python_is_installed_like_the_rest(clone, tmp_path, root):
    """As in a container image of Debian: apt brings python3, as root or through sudo, then the set-up goes on."""
    python, calls = tmp_path / "python3", tmp_path / "calls"
    script = tmp_path / "applr"
    script.write_text(script.read_text().replace("/usr/bin/python3", str(python)))
    apt = "echo $* >>%s; case $* in *' python3') ln -s %s %s ;; *rospy*) echo E: full >&2; exit 100 ;; esac"
    stand_ins = {
        "id": "echo %d" % (0 if root else 1000),
        "apt-get": apt % (calls, sys.executable, python),
        "sudo": 'if [ "$2" = true ]; then exit 0; fi; echo as root >>%s; shift; exec "$@"' % calls,
    }
    code, lines = clone("setup", stand_ins=dict(NOTHING, **stand_ins))
    done = calls.read_text().splitlines()
    assert ("as root" in done) is not root
    installed = [line for line in done if "install" in line]
    assert installed[0].split()[-1] == "python3"
    assert "python3-rospy" in installed[1] or "ros-noetic-rospy" in installed[1]  # it went on to the other packages
    assert code == 1
    assert lines[-1].startswith("applr: apt-get could not install")


def test_a_missing_python_is_named_where_nothing_may_be_installed(clone, tmp_path):
    script = tmp_path / "applr"
    script.write_text(script.read_text().replace("/usr/bin/python3", str(tmp_path / "python3")))
    code, lines = clone("setup", stand_ins=dict(NOTHING, id="echo 1000", sudo="exit 1"))
    assert (code, len(lines)) == (1, 1)
    assert lines[0].endswith("apt-get install -y --no-install-recommends python3")


def test_without_network_pip_says_so(clone):
    code, lines = clone(
        "setup", stand_ins=ALL, PIP_NO_INDEX="1", PIP_FIND_LINKS="/no/such/folder", PIP_CONFIG_FILE=os.devnull
    )
    assert code == 1
    assert "network" in lines[-1]
    assert all(line.startswith("applr: ") for line in lines)


def test_a_second_run_does_nothing():
    if not os.path.exists(os.path.join(ROOT, ".applr", "venv.stamp")):
        pytest.skip("set-up has not been done here")
    setup = [os.path.join(ROOT, "applr"), "setup"]
    subprocess.run(setup, capture_output=True, timeout=120, check=True)
    done = subprocess.run(setup, capture_output=True, text=True, timeout=2.0, check=False)
    assert (done.returncode, done.stderr) == (0, "applr: ready\n")
