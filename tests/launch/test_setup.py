"""Tests of set-up by ./applr: it makes missing parts, and reports an error in one line with a
non-zero exit status.

A copy of the script runs in another folder, with stand-ins for system programs first on PATH.
Nothing is installed.
"""

import os
import re
import shutil
import signal
import subprocess
import sys

import pytest

from tests.support import HANGS, ROOT
from tests.support.ros import wait_for


class Clone:
    """Clone with the files that set-up reads. A call runs ./applr and returns (exit status, error
    lines).
    """

    def __init__(self, folder):
        self.folder = folder
        self.programs = folder / "stand-ins"
        self.stdout = ""
        self.programs.mkdir()
        for name in ("applr", "CMakeLists.txt", "package.xml", "setup.py"):
            shutil.copy2(ROOT / name, folder / name)
        package = ("applr_ros1/cfg", "applr_ros1/planner", "applr_ros1/scripts")
        for name in ("requirements", "msg", "srv", "compat", *package):
            shutil.copytree(
                ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__")
            )

    def start(self, *words, stand_ins=(), before=(), stderr=subprocess.PIPE, **environment):
        """Start ./applr with stand-ins {program: body of a shell script}, and `before` in front of
        the command.
        """
        for name, body in dict(stand_ins).items():
            (self.programs / name).write_text("#!/bin/sh\n" + body + "\n")
            (self.programs / name).chmod(0o755)
        environment = dict(os.environ, PATH="%s:/usr/bin:/bin" % self.programs, **environment)
        pipes = {"stdout": subprocess.PIPE, "stderr": stderr, "text": True}
        return subprocess.Popen(
            [*before, self.folder / "applr", *words],
            env=environment,
            start_new_session=True,
            **pipes,
        )

    def __call__(self, *words, **options):
        started = self.start(*words, **options)
        self.stdout, errors = started.communicate(timeout=HANGS)
        return started.returncode, errors.strip().splitlines()

    def refusal(self, *words, **options):
        """Return the one-line error of a command."""
        status, (line,) = self(*words, **options)
        assert status == 1
        return line

    def quick(self, *words, **environment):
        """Run ./applr with a set-up that takes no time."""
        # `before` makes the clone read-only.
        stand_ins = {} if environment.get("before") else QUICK
        return self(
            *words, stand_ins=stand_ins, APPLR_PYTHON=str(self.programs / "python"), **environment
        )


@pytest.fixture
def clone(tmp_path):
    """Return a clone that has not been set up."""
    return Clone(tmp_path)


NOTHING = {"dpkg-query": "exit 1"}
ALL = {"dpkg-query": 'shift 3; for p in "$@"; do echo installed $p; done'}
# instant set-up: an interpreter that copies itself into the venv, and an empty workspace
PYTHON = """
here=$(dirname "$0"); for last; do :; done
case "$*" in
  *'import sys; print'*) echo 3.11 ;;
  *'-m venv '*) mkdir -p "$last/bin"; cp "$0" "$last/bin/python" ;;
  *'-m pip --version'*) [ ! -e "$here/no-pip" ] ;;
  *'-m pip install'*) echo "pip sees ${PYTHONPATH:-nothing}"; eval "$PIP_STAND_IN" ;;
esac"""
QUICK = dict(ALL, python=PYTHON, catkin_make='mkdir -p "$2/devel"; echo : >"$2/devel/setup.bash"')
VENV = "applr: installing Python packages (some minutes the first time)"
WORKSPACE = "applr: building the catkin workspace"


def test_help_and_wrong_commands(clone, tmp_path):
    for words in (["--help"], ["packages", "--help"], ["exec", "--help"]):
        assert clone(*words) == (0, [])
        assert clone.stdout.startswith("usage: ./applr COMMAND")
    for words, remedy in ((["dance"], "setup"), (["packages", "--force"], "omit --force")):
        assert remedy in clone.refusal(*words)
    assert not (tmp_path / ".applr").exists()


@pytest.mark.parametrize("name", ["my clone", "a$b"])
def test_a_path_in_which_catkin_cannot_build_is_refused_at_once(clone, tmp_path, name):
    (tmp_path / name).mkdir()
    shutil.move(tmp_path / "applr", tmp_path / name / "applr")
    os.symlink(tmp_path / name / "applr", tmp_path / "applr")
    line = clone.refusal("setup", stand_ins=QUICK)
    assert f"this clone lies in {tmp_path / name}: catkin" in line
    assert os.listdir(tmp_path / name) == ["applr"]


def test_missing_parts_of_a_set_up_are_made_again(clone, tmp_path):
    state = tmp_path / ".applr"
    assert clone.quick("exec", "true") == (0, [VENV, WORKSPACE])
    assert clone.quick("exec", "true") == (0, [])
    shutil.rmtree(state / "venv")
    assert clone.quick("exec", "true") == (0, [VENV])
    shutil.rmtree(state / "catkin_ws")
    assert clone.quick("exec", "true") == (0, [WORKSPACE])
    # As after a set-up that was stopped while making the venv
    (state / "venv.stamp").unlink()
    (state / "venv" / "bin" / "no-pip").touch()
    assert clone.quick("exec", "true") == (0, [VENV])
    assert not (state / "venv" / "bin" / "no-pip").exists()


def test_packages_of_another_workspace_do_not_count(clone, tmp_path):
    """pip would count such packages as installed, and PYTHONHOME would break Python. ./applr exec
    passes both on.
    """
    environment = {"PYTHONPATH": "/elsewhere", "PYTHONHOME": "/nowhere"}
    assert clone.quick("exec", "sh", "-c", "echo $PYTHONPATH", **environment)[0] == 0
    assert clone.stdout == "/elsewhere\n"
    log = (tmp_path / ".applr" / "setup.log").read_text()
    assert "pip sees nothing" in log
    assert "/elsewhere" not in log
    # A real interpreter.
    python = {"APPLR_PYTHON": sys.executable, "PYTHONHOME": "/nowhere"}
    _, lines = clone("setup", stand_ins=dict(NOTHING, id="echo 1000", sudo="exit 1"), **python)
    assert "packages are missing" in lines[-1]


def test_a_read_only_clone_with_a_complete_set_up_is_used(clone, tmp_path):
    """A container image built by root contains such a clone."""
    how = f'mount --bind {tmp_path} {tmp_path}; mount -o remount,ro,bind {tmp_path}; exec "$0" "$@"'
    as_root = [] if os.getuid() == 0 else ["--map-root-user"]
    read_only = ["unshare", "--mount", *as_root, "sh", "-ec", how]
    if subprocess.run([*read_only, "true"], capture_output=True).returncode:
        pytest.skip("no namespaces for mounts here")
    clone.start("--help", stand_ins=QUICK).communicate(timeout=HANGS)
    (line,) = clone.quick("exec", "true", before=read_only)[1]
    assert line == f"applr: cannot write {tmp_path}/.applr: use a clone that you own"
    assert clone.quick("exec", "true")[0] == 0
    assert clone.quick("exec", "true", before=read_only) == (0, [])


def test_a_stopped_set_up_continues_the_next_time(clone, tmp_path):
    # Short sleeps: an interrupt just before a sleep reaches only the shell, which ends after the
    # sleep.
    waiting = {
        "PIP_STAND_IN": "while sleep .1; do :; done",
        "APPLR_PYTHON": str(clone.programs / "python"),
    }
    stopped = clone.start("exec", "true", stand_ins=QUICK, **waiting)
    log = tmp_path / ".applr" / "setup.log"
    wait_for(lambda: log.exists() and "pip sees" in log.read_text(), "pip")
    os.killpg(stopped.pid, signal.SIGINT)  # as Ctrl-C in a terminal
    _, errors = stopped.communicate(timeout=HANGS)
    assert stopped.returncode == 130
    assert errors.splitlines()[1:] == ["applr: stopped; the same command continues from here"]
    assert clone.quick("exec", "true") == (0, [VENV, WORKSPACE])


def test_exec_starts_programs_and_has_no_options(clone):
    assert clone.quick("exec", "--", "echo", "-c")[0] == 0
    assert clone.stdout == "-c\n"
    # Not an option of the shell's exec, and not a function of the script
    for word in ("-c", "usage"):
        line = "applr: exec %s: there is no such program, or it is not executable" % word
        assert clone.quick("exec", word) == (127, [line])


def test_without_root_the_missing_packages_are_named(clone, tmp_path):
    stand_ins = dict(NOTHING, id="echo 1000", sudo="exit 1")
    line = clone.refusal("setup", stand_ins=stand_ins)
    assert re.search("apt-get install.* (python3|ros-noetic)-rospy", line)
    script = tmp_path / "applr"  # Now python3 itself is missing, too.
    script.write_text(script.read_text().replace("/usr/bin/python3", str(tmp_path / "python3")))
    line = clone.refusal("setup", stand_ins=stand_ins)
    assert line.endswith("apt-get install -y --no-install-recommends python3")


def test_without_network_the_error_of_apt_is_shown(clone):
    apt = {"apt-get": "echo 'E: Unable to fetch some archives' >&2; exit 100"}
    code, lines = clone("setup", stand_ins=dict(NOTHING, id="echo 0", **apt))
    assert code == 1
    assert "network" in lines[-1]
    assert "Unable to fetch" in lines[-1]
    assert all(line.startswith("applr: ") for line in lines)


def test_missing_or_changed_kernels_are_compiled_before_a_drive(clone, tmp_path):
    """As the real compiler, its stand-in prints the cache folder after a line of a library."""
    machine_code = tmp_path / "machine code"
    (tmp_path / "sim_bridge").mkdir()
    (tmp_path / "sim_bridge" / "wheels.py").write_text("A = 1")
    compiles_kernels = (
        f'echo compiling >&2; mkdir -p "{machine_code}"; echo a; echo "{machine_code}"'
    )
    compiler = f'case "$*" in *compile_kernels) {compiles_kernels} ;; esac'
    stand_ins = dict(QUICK, python=PYTHON + "\n" + compiler)
    python = str(clone.programs / "python")

    def compiles(*words, **environment):
        lines = clone(*words, stand_ins=stand_ins, APPLR_PYTHON=python, **environment)[1]
        return "compiling" in lines

    # exec runs any command, most of which need no kernels.
    assert not compiles("exec", "true")
    assert compiles("setup")
    assert not compiles("setup")

    # Missing machine code, and a file that has changed
    shutil.rmtree(machine_code)
    assert compiles("demo")
    for command in ("demo", "play", "tune"):
        assert not compiles(command)
    (tmp_path / "sim_bridge" / "wheels.py").write_text("A = 2")
    assert compiles("tune")
    assert not compiles("tune")
    assert compiles("setup", XDG_CACHE_HOME=str(tmp_path))  # another folder


def test_an_old_and_a_missing_python_are_refused(clone):
    stand_ins = {"old-python": "echo 3.7"}
    for python, problem in (
        (str(clone.programs / "old-python"), "3.7: 3.8 or later"),
        ("/no/such", "no /no/such"),
    ):
        assert problem in clone.refusal("setup", stand_ins=stand_ins, APPLR_PYTHON=python)


@pytest.mark.parametrize("is_root", [True, False])
def test_a_missing_python_is_installed_like_the_rest(clone, tmp_path, is_root):
    """As in a Debian container, apt installs python3, as root or through sudo. The set-up then goes
    on.
    """
    python = tmp_path / "python3"
    calls = tmp_path / "calls"
    script = tmp_path / "applr"
    script.write_text(script.read_text().replace("/usr/bin/python3", str(python)))
    installs_python = f"*' python3') ln -s {sys.executable} {python} ;;"
    fails = "*rospy*) echo E: full >&2; exit 100 ;;"
    stand_ins = {
        "id": "echo %d" % (0 if is_root else 1000),
        "apt-get": f"echo $* >>{calls}; case $* in -s*) ;; {installs_python} {fails} esac",
        "sudo": 'if [ "$2" = true ]; then exit 0; fi; echo as root >>%s; shift; exec "$@"' % calls,
    }
    code, lines = clone("setup", stand_ins=dict(NOTHING, **stand_ins))
    called = calls.read_text().splitlines()
    assert ("as root" in called) is not is_root
    installations = [line for line in called if line.startswith("install")]
    assert installations[0].split()[-1] == "python3"
    # The next packages.
    assert "python3-rospy" in installations[1] or "ros-noetic-rospy" in installations[1]
    assert code == 1
    assert lines[-1].startswith("applr: apt-get could not install")


def test_a_second_run_does_nothing():
    if not os.path.exists(os.path.join(ROOT, ".applr", "venv.stamp")):
        pytest.skip("set-up has not been done here")
    setup = [os.path.join(ROOT, "applr"), "setup"]
    subprocess.run(setup, capture_output=True, timeout=HANGS, check=True)
    finished = subprocess.run(setup, capture_output=True, text=True, timeout=HANGS, check=False)
    assert (finished.returncode, finished.stderr) == (0, "applr: ready\n")
