"""For all tests: what is left out, what counts as a failure, and a process for each file that starts ROS nodes.

A run in which no test passed is a failure. A file that imports what is not installed (ROS, or torch on Noetic's Python
3.8) is left out and named. Each file that starts ROS nodes has a process, and so a ROS master, of its own.

rospy knows one master and one node name per process. Where several files with ROS tests are collected, each is
therefore run by a pytest below this one and reported as one test, with that pytest's output if it fails. Alone, a file
runs here.
"""

import ast
import importlib.util
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

CHILD = "APPLR_TESTS_OF_ONE_FILE"
HERE = Path(__file__).parent
USES_ROS = re.compile(
    r"^\s*(from|import) (rospy|%s)\b"
    % "|".join(path.stem for path in HERE.glob("*.py") if "import rospy" in path.read_text(encoding="utf-8")),
    re.MULTILINE,
)
LONGEST = 900  # seconds for one file

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # as a shell starts what it puts in the background:
    signal.signal(signal.SIGINT, signal.default_int_handler)  # tests interrupt children, which would inherit it

NEEDS = {"training": "torch", "ros_harness": "rospy"}  # what these import later
OWN = {"applr_ros1", "sim_bridge", "worlds", "training"}


def missing_modules(path):
    """Modules that a test file imports at its top, itself or through its helpers, and that are not installed."""
    statements = ast.parse(path.read_text(encoding="utf-8")).body
    names = {alias.name for node in statements if isinstance(node, ast.Import) for alias in node.names}
    names |= {node.module for node in statements if isinstance(node, ast.ImportFrom) and node.module}
    names = {name.partition(".")[0] for name in names}
    names |= {NEEDS[name] for name in names if name in NEEDS}
    missing = set()
    for name in names - OWN:
        helper = HERE / (name + ".py")
        if helper.exists():
            missing |= missing_modules(helper)
        elif importlib.util.find_spec(name) is None:
            missing.add(name)
    return missing


pytest.register_assert_rewrite("move_base_stack")  # has assertions, and is imported by name
LEFT_OUT = {path.name: sorted(missing) for path in sorted(HERE.glob("test_*.py")) if (missing := missing_modules(path))}
collect_ignore = list(LEFT_OUT)


class FileInOwnProcess(pytest.Item):
    """All selected tests of one file, run by another pytest."""

    def __init__(self, tests, **options):
        super().__init__(**options)
        self.tests, self.output = tests, ""

    def runtest(self):
        command = [sys.executable, "-m", "pytest", "--no-header", "-p", "no:cacheprovider", *self.tests]
        try:
            done = subprocess.run(
                command,
                env=dict(os.environ, **{CHILD: "1"}),
                cwd=self.config.rootpath,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                timeout=LONGEST,
                check=False,
            )
        except subprocess.TimeoutExpired as late:
            self.output = "not done within %d s\n%s" % (LONGEST, (late.stdout or b"").decode(errors="replace"))
            raise FileFailed from None
        self.output = done.stdout
        last = done.stdout.strip().splitlines()[-1:]
        self.config.stash[SUMMARIES].append("%s: %s" % (self.path.name, "".join(last).strip("= ")))
        if done.returncode:
            raise FileFailed

    def repr_failure(self, excinfo, style=None):
        return self.output if excinfo.errisinstance(FileFailed) else super().repr_failure(excinfo)

    def reportinfo(self):
        return self.path, None, "%d tests in a process of their own" % len(self.tests)


class FileFailed(Exception):
    """Some test of the file did not pass; the output says which."""


SUMMARIES = pytest.StashKey()


def pytest_configure(config):
    config.stash[SUMMARIES] = []


def pytest_collection_modifyitems(config, items):
    if CHILD in os.environ or config.option.collectonly:
        return
    by_file = {}
    for item in items:
        by_file.setdefault(item.path, []).append(item)
    apart = [path for path in by_file if USES_ROS.search(path.read_text(encoding="utf-8"))]
    if len(apart) < 2:
        return
    items[:] = [item for item in items if item.path not in apart]
    for path in apart:
        items.append(
            FileInOwnProcess.from_parent(
                by_file[path][0].getparent(pytest.Module),
                name="own process",
                tests=[item.nodeid for item in by_file[path]],
            )
        )


def pytest_terminal_summary(terminalreporter):
    for name, missing in LEFT_OUT.items():
        terminalreporter.write_line("%s left out: no %s here" % (name, ", ".join(missing)))
    for line in terminalreporter.config.stash[SUMMARIES]:
        terminalreporter.write_line(line)


def pytest_sessionfinish(session, exitstatus):
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    collected = exitstatus == 0 and reporter is not None and not session.config.option.collectonly
    if collected and not reporter.stats.get("passed"):
        session.exitstatus = 5
