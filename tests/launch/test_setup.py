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
import xml.etree.ElementTree as xml
from typing import List, NamedTuple

import pytest

from tests.support import HANGS, ROOT, is_alive
from tests.support.ros import wait_for


class Ended(NamedTuple):
    """Exit status of ./applr, and its lines on stderr."""

    status: int
    lines: List[str]


class Clone:
    """Clone with the files that set-up reads. A call runs ./applr to its end."""

    def __init__(self, folder):
        self.folder = folder
        self.programs = folder / "stand-ins"
        self.stdout = ""
        self.programs.mkdir()
        for file_name in ("applr", "CMakeLists.txt", "package.xml", "setup.py"):
            shutil.copy2(ROOT / file_name, folder / file_name)
        package_folders = ("cfg", "launch", "nodes/tools", "planner", "scripts")
        without_caches = shutil.ignore_patterns("__pycache__")
        in_package = [f"applr_ros1/{package_folder}" for package_folder in package_folders]
        for copied_folder in ("requirements", "msg", "srv", "compat", *in_package):
            shutil.copytree(ROOT / copied_folder, folder / copied_folder, ignore=without_caches)

    def start(self, *words, stand_ins=(), before=(), stderr=subprocess.PIPE, **environment):
        """Start ./applr with stand-ins {program: body of a shell script}, and `before` in front of
        the command.
        """
        for program_name, shell_body in dict(stand_ins).items():
            stand_in = self.programs / program_name
            stand_in.write_text("#!/bin/sh\n" + shell_body + "\n")
            stand_in.chmod(0o755)
        environment = dict(os.environ, PATH="%s:/usr/bin:/bin" % self.programs, **environment)
        return subprocess.Popen(
            [*before, self.folder / "applr", *words],
            env=environment,
            start_new_session=True,
            stdout=subprocess.PIPE,
            stderr=stderr,
            text=True,
        )

    def __call__(self, *words, **options):
        running = self.start(*words, **options)
        self.stdout, errors = running.communicate(timeout=HANGS)
        return Ended(running.returncode, errors.strip().splitlines())

    def refusal(self, *words, **options):
        """Return the one-line error of a command."""
        ended = self(*words, **options)
        assert ended.status == 1
        (error_line,) = ended.lines
        return error_line

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


# Stand-ins that report that no package of the system is installed, or every one
NOTHING = {"dpkg-query": "exit 1"}
ALL = {"dpkg-query": 'shift 3; for p in "$@"; do echo installed $p; done'}
# Instant set-up: an interpreter that copies itself into the venv, and an empty workspace
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
    error_line = clone.refusal("setup", stand_ins=QUICK)
    assert f"this clone lies in {tmp_path / name}: catkin" in error_line
    assert os.listdir(tmp_path / name) == ["applr"]


def test_missing_parts_of_a_set_up_are_made_again(clone, tmp_path):
    set_up_folder = tmp_path / ".applr"
    assert clone.quick("exec", "true") == (0, [VENV, WORKSPACE])
    assert clone.quick("exec", "true") == (0, [])
    shutil.rmtree(set_up_folder / "venv")
    assert clone.quick("exec", "true") == (0, [VENV])
    shutil.rmtree(set_up_folder / "catkin_ws")
    assert clone.quick("exec", "true") == (0, [WORKSPACE])
    # As after a set-up that was stopped while making the venv
    (set_up_folder / "venv.stamp").unlink()
    (set_up_folder / "venv" / "bin" / "no-pip").touch()
    assert clone.quick("exec", "true") == (0, [VENV])
    assert not (set_up_folder / "venv" / "bin" / "no-pip").exists()


def test_quick_tests_need_no_system_packages(clone):
    (clone.folder / "sim_bridge").mkdir()  # Its files count for the compiled kernels.
    own_python = str(clone.programs / "python")
    without_root = dict(QUICK, **NOTHING, id="echo 1000", sudo="exit 1")
    ended = clone("test", "--quick", stand_ins=without_root, APPLR_PYTHON=own_python)
    assert ended == (0, [VENV])


def test_packages_of_another_workspace_do_not_count(clone, tmp_path):
    """pip would count such packages as installed, and PYTHONHOME would break Python. ./applr exec
    passes both on.
    """
    environment = {"PYTHONPATH": "/elsewhere", "PYTHONHOME": "/nowhere"}
    assert clone.quick("exec", "sh", "-c", "echo $PYTHONPATH", **environment).status == 0
    assert clone.stdout == "/elsewhere\n"
    log_text = (tmp_path / ".applr" / "setup.log").read_text()
    assert "pip sees nothing" in log_text
    assert "/elsewhere" not in log_text

    # A real interpreter, which PYTHONHOME would break.
    real_python = {"APPLR_PYTHON": sys.executable, "PYTHONHOME": "/nowhere"}
    without_root = dict(NOTHING, id="echo 1000", sudo="exit 1")
    ended = clone("setup", stand_ins=without_root, **real_python)
    assert "packages are missing" in ended.lines[-1]


def test_a_read_only_clone_with_a_complete_set_up_is_used(clone, tmp_path):
    """A container image built by root contains such a clone."""
    mount_read_only = f"mount --bind {tmp_path} {tmp_path}; mount -o remount,ro,bind {tmp_path}"
    as_root = [] if os.getuid() == 0 else ["--map-root-user"]
    run_command = 'exec "$0" "$@"'
    shell = ["sh", "-ec", f"{mount_read_only}; {run_command}"]
    read_only = ["unshare", "--mount", *as_root, *shell]
    if subprocess.run([*read_only, "true"], capture_output=True).returncode:
        pytest.skip("no namespaces for mounts here")

    # The stand-ins are written before the clone is read-only.
    clone.start("--help", stand_ins=QUICK).communicate(timeout=HANGS)
    (error_line,) = clone.quick("exec", "true", before=read_only).lines
    assert error_line == f"applr: cannot write {tmp_path}/.applr: use a clone that you own"
    assert clone.quick("exec", "true").status == 0
    assert clone.quick("exec", "true", before=read_only) == (0, [])


def test_a_stopped_set_up_continues_the_next_time(clone, tmp_path):
    # Short sleeps: an interrupt just before a sleep reaches only the shell, which ends after the
    # sleep.
    endless_pip = {
        "PIP_STAND_IN": "while sleep .1; do :; done",
        "APPLR_PYTHON": str(clone.programs / "python"),
    }
    stopped = clone.start("exec", "true", stand_ins=QUICK, **endless_pip)
    log_file = tmp_path / ".applr" / "setup.log"
    wait_for(lambda: log_file.exists() and "pip sees" in log_file.read_text(), "pip")
    os.killpg(stopped.pid, signal.SIGINT)  # as Ctrl-C in a terminal
    _, errors = stopped.communicate(timeout=HANGS)
    assert stopped.returncode == 130
    assert errors.splitlines()[1:] == ["applr: stopped; the same command continues from here"]
    assert clone.quick("exec", "true") == (0, [VENV, WORKSPACE])


@pytest.mark.parametrize("stage", ["pip", "kernels", "lock"])
def test_a_terminated_set_up_leaves_no_process(clone, tmp_path, stage):
    """A service manager or a script sends SIGTERM to ./applr alone."""
    pid_file = tmp_path / "pid"
    endless = f"echo $$ >{pid_file}; while sleep .1; do :; done"
    compiles = f'case "$*" in *compile_kernels) {endless} ;; esac'
    environment = {
        "PIP_STAND_IN": endless if stage == "pip" else "",
        "APPLR_PYTHON": str(clone.programs / "python"),
    }
    stand_ins = dict(QUICK)
    if stage == "kernels":
        stand_ins["python"] = f"{PYTHON}\n{compiles}"
    if stage == "lock":
        stand_ins["flock"] = f'[ "$1" = -w ] || exit 1; {endless}'
    stopped = clone.start("setup", stand_ins=stand_ins, **environment)
    wait_for(lambda: pid_file.exists() and pid_file.read_text().strip(), "an endless program")
    stopped.terminate()
    _, errors = stopped.communicate(timeout=HANGS)
    assert stopped.returncode == 128 + signal.SIGTERM
    assert errors.splitlines()[-1] == "applr: stopped; the same command continues from here"
    wait_for(lambda: not is_alive(int(pid_file.read_text())), "the end of the program")


@pytest.mark.parametrize("command", ["play", "robot", "check", "tune", "why", "evaluate", "train"])
def test_what_an_old_python_cannot_run_is_refused_before_anything_is_installed(clone, command):
    stand_ins = dict(NOTHING, python=PYTHON.replace("echo 3.11", "echo 3.8"))
    python = str(clone.programs / "python")
    error_line = clone.refusal(command, stand_ins=stand_ins, APPLR_PYTHON=python)
    assert error_line.startswith(f"applr: {command} needs Python 3.10 or later, this is 3.8: ")


@pytest.mark.parametrize(
    ("words", "wrong"),
    [
        (["demo", "worl:=generated:7"], "worl:=generated:7"),
        (["demo", "world:=generated:7", "--headless"], "--headless"),
        (["demo", "world:="], "world:="),
        (["play", "--no-browser", "page:=none"], "page:=none"),  # an argument of the demo alone
    ],
)
def test_a_misspelt_argument_is_refused_before_anything_is_installed(clone, words, wrong):
    error_line = clone.refusal(*words, stand_ins=NOTHING)
    declarations = xml.parse(ROOT / "applr_ros1/launch/jackal_applr.launch").findall("arg")
    known = dict.fromkeys(arg.get("name") for arg in declarations if arg.get("doc"))
    if words[0] == "demo":
        known.update(page=None, limit=None)
    problem = f"applr: {wrong} is not an argument"
    assert error_line == f"{problem}: give ARG:=VALUE with one of {', '.join(known)}"
    assert not (clone.folder / ".applr").exists()


def test_the_arguments_of_demo_and_play_are_accepted(clone):
    no_python = {"APPLR_PYTHON": "/no/such"}  # The set-up begins, and ends at once.
    of_demo = ["world:=generated:7", "max_speed:=0.4", "page:=none", "limit:=9", "__name:=mine"]
    assert "no /no/such" in clone.refusal("demo", *of_demo, **no_python)
    assert "no /no/such" in clone.refusal("play", "--no-browser", "robot:=husky", **no_python)


def test_each_program_has_a_command(clone):
    """The stand-in workspace has no programs, so that the Python of the venv reports the path."""
    quick_python = PYTHON + '\ncase "$1" in *.py) echo "$1" ;; esac'
    stand_ins = dict(QUICK, python=quick_python)
    (clone.folder / "sim_bridge").mkdir()
    own_python = str(clone.programs / "python")
    for command, program in (
        ("check", "check_robot"),
        ("evaluate", "evaluate"),
        ("train", "train"),
    ):
        ended = clone(command, "--help", stand_ins=stand_ins, APPLR_PYTHON=own_python)
        assert ended.status == 0
        assert clone.stdout.endswith(f"devel/lib/applr_ros1/{program}.py\n")


def test_exec_starts_programs_and_has_no_options(clone):
    assert clone.quick("exec", "--", "echo", "-c").status == 0
    assert clone.stdout == "-c\n"
    # Not an option of the shell's exec, and not a function of the script
    for no_program in ("-c", "usage"):
        problem = "there is no such program, or it is not executable"
        error_line = f"applr: exec {no_program}: {problem}"
        assert clone.quick("exec", no_program) == (127, [error_line])


def test_without_root_the_missing_packages_are_named(clone, tmp_path):
    stand_ins = dict(NOTHING, id="echo 1000", sudo="exit 1")
    error_line = clone.refusal("setup", stand_ins=stand_ins)
    assert re.search("apt-get install.* (python3|ros-noetic)-rospy", error_line)

    # Now python3 itself is missing, too.
    script = tmp_path / "applr"
    script.write_text(script.read_text().replace("/usr/bin/python3", str(tmp_path / "python3")))
    error_line = clone.refusal("setup", stand_ins=stand_ins)
    assert error_line.endswith("apt-get install -y --no-install-recommends python3")


def test_without_network_the_error_of_apt_is_shown(clone):
    failing_apt = {"apt-get": "echo 'E: Unable to fetch some archives' >&2; exit 100"}
    ended = clone("setup", stand_ins=dict(NOTHING, id="echo 0", **failing_apt))
    assert ended.status == 1
    assert "network" in ended.lines[-1]
    assert "Unable to fetch" in ended.lines[-1]
    assert all(line.startswith("applr: ") for line in ended.lines)


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

    reasons = []  # lines about kernels that another user or HOME has compiled

    def compiles(*words, **environment):
        ended = clone(*words, stand_ins=stand_ins, APPLR_PYTHON=python, **environment)
        reasons.extend(line for line in ended.lines if "the compiled kernels are in" in line)
        return "compiling" in ended.lines

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
    assert not reasons
    assert compiles("setup", XDG_CACHE_HOME=str(tmp_path))  # another folder
    assert f"; they are needed in that of user {os.getuid()}, HOME=" in reasons[0]


def test_an_old_and_a_missing_python_are_refused(clone):
    stand_ins = {"old-python": "echo 3.7"}
    for python, problem in (
        (str(clone.programs / "old-python"), "3.7: 3.8 or later"),
        ("/no/such", "no /no/such"),
    ):
        assert problem in clone.refusal("setup", stand_ins=stand_ins, APPLR_PYTHON=python)


def test_a_python_that_does_not_see_the_modules_of_ros_is_refused_at_once(clone, tmp_path):
    """As one of pyenv, for which catkin_make would fail after all packages are installed."""
    own_prefix = tmp_path / "own"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", own_prefix], check=True)
    python = str(own_prefix / "bin" / "python")
    for command in ("setup", "packages"):
        error_line = clone.refusal(command, stand_ins=NOTHING, APPLR_PYTHON=python)
        assert error_line.startswith(f"applr: {python} does not see the Python modules of ROS in ")


@pytest.mark.parametrize("is_root", [True, False])
def test_a_missing_python_is_installed_like_the_rest(clone, tmp_path, is_root):
    """As in a Debian container, apt installs python3, as root or through sudo. The set-up then goes
    on.
    """
    python = tmp_path / "python3"
    # File to which the stand-ins write how they are called
    calls_file = tmp_path / "calls"
    script = tmp_path / "applr"
    script.write_text(script.read_text().replace("/usr/bin/python3", str(python)))
    installs_python = f"*' python3') ln -s {sys.executable} {python} ;;"
    # The test ends here: the disk is full when the next packages are to be installed.
    full_disk = "*rospy*) echo E: full >&2; exit 100 ;;"
    user_number = 0 if is_root else 1000
    becomes_root = f'echo as root >>{calls_file}; shift; exec "$@"'
    stand_ins = {
        "id": f"echo {user_number}",
        "apt-get": f"echo $* >>{calls_file}; case $* in -s*) ;; {installs_python} {full_disk} esac",
        "sudo": f'if [ "$2" = true ]; then exit 0; fi; {becomes_root}',
    }
    ended = clone("setup", stand_ins=dict(NOTHING, **stand_ins))
    calls = calls_file.read_text().splitlines()
    assert ("as root" in calls) is not is_root
    installations = [call for call in calls if call.startswith("install")]
    assert installations[0].split()[-1] == "python3"
    assert "python3-rospy" in installations[1] or "ros-noetic-rospy" in installations[1]
    assert ended.status == 1
    assert ended.lines[-1].startswith("applr: apt-get could not install")


# Not beside tests that start ./applr of this clone, too: it would say that it waits for them.
@pytest.mark.xdist_group("test_launch")
def test_a_second_run_does_nothing():
    if not os.path.exists(os.path.join(ROOT, ".applr", "venv.stamp")):
        pytest.skip("set-up has not been done here")
    command = [os.path.join(ROOT, "applr"), "setup"]
    # The first run may have something to do.
    subprocess.run(command, capture_output=True, timeout=HANGS, check=True)
    finished = subprocess.run(command, capture_output=True, text=True, timeout=HANGS, check=False)
    assert (finished.returncode, finished.stderr) == (0, "applr: ready\n")
