"""For all tests: what is left out, what counts as a failure, and a process for each file that starts ROS nodes.

A run in which no test passed is a failure. A file that imports what is not installed (ROS, or torch on Noetic's Python
3.8) is left out and named. Each file that starts ROS nodes has a process, and so a ROS master, of its own.

rospy knows one master and one node name per process. Where several files with ROS tests are collected, each is
therefore run by a pytest below this one and reported as one test, with that pytest's output if it fails. They mostly
wait: one of them runs beside the tests that need no ROS, and two at a time do after those. Alone, a file runs here. The
files of tests/faults/ share one such process, since they share one running stack.

Tests marked `long` are left out unless `-m` names them. `--faults-table FILE` writes the figures that tests measure.
"""

import ast
import importlib.util
import itertools
import json
import os
import re
import signal
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

CHILD = "APPLR_TESTS_OF_ONE_FILE"
HERE = Path(__file__).parent
USES_ROS = re.compile(
    r"^\s*(from|import) (rospy|%s)\b"
    % "|".join(path.stem for path in HERE.rglob("*.py") if "import rospy" in path.read_text(encoding="utf-8")),
    re.MULTILINE,
)
LONGEST = 900  # seconds for one file
AT_A_TIME = 2  # files that start ROS nodes, once the other tests are done; one beside them
SLOW = 15  # a test marked `slow` takes as long as about so many others

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # as a shell starts what it puts in the background:
    signal.signal(signal.SIGINT, signal.default_int_handler)  # tests interrupt children, which would inherit it
for number in (signal.SIGTERM, signal.SIGHUP):  # a job that is cancelled, a terminal that is closed: as Ctrl-C, so
    if signal.getsignal(number) == signal.SIG_DFL:  # that what the tests have started ends, too
        signal.signal(number, signal.default_int_handler)
os.environ.pop("ROS_NAMESPACE", None)  # of a robot of the person's: tests name topics from the root

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
        helpers = [folder / (name + ".py") for folder in (HERE, path.parent) if (folder / (name + ".py")).exists()]
        if helpers:
            missing |= missing_modules(helpers[0])
        elif importlib.util.find_spec(name) is None:
            missing.add(name)
    return missing


pytest.register_assert_rewrite("move_base_stack", "applr_node_stack")  # have assertions, and are imported by name
LEFT_OUT = {
    str(path.relative_to(HERE)): sorted(missing)
    for path in sorted(HERE.rglob("test_*.py"))
    if (missing := missing_modules(path))
}
collect_ignore = list(LEFT_OUT)


def process_of(path):
    """What is run in one process: a file, or the folder of files that share a running stack."""
    return path if path.parent == HERE else path.parent


def duration(tests):
    """How long tests take, in units of a usual test."""
    return sum(SLOW if item.get_closest_marker("slow") else 1 for item in tests)


class FileInOwnProcess(pytest.Item):
    """All selected tests of one file, or of one folder, run by another pytest."""

    def __init__(self, tests, **options):
        super().__init__(**options)
        self.tests, self.output = tests, ""
        self.run = None  # the Future of the run
        self.process = None  # the pytest below this one, once it runs

    def runtest(self):
        self.config.stash[OTHERS_DONE].set()
        self.run.result()

    def run_tests(self):
        """Run the tests and keep their output. Raises FileFailed."""
        command = [sys.executable, "-m", "pytest", "--no-header", "-p", "no:cacheprovider", *self.tests]
        command += ["-m", self.config.option.markexpr] if self.config.option.markexpr else []
        command += ["--faults-table", self.config.option.faults_table] if self.config.option.faults_table else []
        self.process = subprocess.Popen(
            command,
            env=dict(os.environ, **{CHILD: "1"}),
            cwd=self.config.rootpath,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        late = threading.Timer(LONGEST, self.end)
        late.start()
        self.output, _ = self.process.communicate()
        late.cancel()
        last = self.output.strip().splitlines()[-1:]
        self.config.stash[SUMMARIES].append("%s: %s" % (process_of(self.path).name, "".join(last).strip("= ")))
        if self.process.returncode:
            raise FileFailed

    def end(self):
        """Interrupt the pytest below this one, which then ends what its tests have started."""
        if self.process is not None and self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)

    def repr_failure(self, excinfo, style=None):
        return self.output if excinfo.errisinstance(FileFailed) else super().repr_failure(excinfo)

    def reportinfo(self):
        return self.path, None, "%d tests in a process of their own" % len(self.tests)


class FileFailed(Exception):
    """Some test of the file did not pass; the output says which."""


SUMMARIES = pytest.StashKey()
RUNS = pytest.StashKey()
OTHERS_DONE = pytest.StashKey()
FIGURES = pytest.StashKey()


def pytest_addoption(parser):
    parser.addoption("--faults-table", metavar="FILE", help="JSON file that gets the figures which tests measure.")


@pytest.fixture
def measured(request):
    """measured(what, value, unit): a figure of this test, for the table of faults."""
    figures = request.config.stash[FIGURES]
    test = "%s::%s" % (request.path.relative_to(HERE.parent).as_posix(), request.node.name.partition("[")[0])

    def keep(what, value, unit):
        figures.append((test, what, float(value), unit))

    return keep


def write_figures(path, figures):
    """Adds figures to a JSON file {test: {what: [largest value, unit]}}."""
    path = Path(path)
    table = json.loads(path.read_text()) if path.exists() else {}
    for test in {test for test, *_ in figures}:
        table[test] = {}
    for test, what, value, unit in figures:
        known = table[test].get(what, [value])[0]
        table[test][what] = [float("%.3g" % max(known, value)), unit]
    path.write_text(json.dumps(table, indent=1, sort_keys=True) + "\n")


def pytest_configure(config):
    config.stash[SUMMARIES] = []
    config.stash[FIGURES] = []
    config.stash[OTHERS_DONE] = done = threading.Event()
    number = itertools.count()
    config.stash[RUNS] = ThreadPoolExecutor(AT_A_TIME, initializer=lambda: next(number) and done.wait())


@pytest.hookimpl(trylast=True)  # after -k, -m and --deselect, which know the tests and not what they are made here
def pytest_collection_modifyitems(config, items):
    if "long" not in config.option.markexpr:
        items[:] = [item for item in items if not item.get_closest_marker("long")]
    if CHILD in os.environ or config.option.collectonly:
        return
    ros = {path for path in {item.path for item in items} if USES_ROS.search(path.read_text(encoding="utf-8"))}
    apart = {}
    for item in items:
        if item.path in ros:
            apart.setdefault(process_of(item.path), []).append(item)
    if len(apart) < 2:
        return
    items[:] = [item for item in items if item.path not in ros]
    for tests in sorted(apart.values(), key=duration, reverse=True):  # the longest first
        items.append(
            FileInOwnProcess.from_parent(
                tests[0].getparent(pytest.Module),
                name="own process",
                tests=[item.nodeid for item in tests],
            )
        )


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop(session):
    for item in session.items:
        if isinstance(item, FileInOwnProcess) and not session.testsfailed:  # collecting has failed otherwise
            item.run = session.config.stash[RUNS].submit(item.run_tests)


def pytest_terminal_summary(terminalreporter):
    for name, missing in LEFT_OUT.items():
        terminalreporter.write_line("%s left out: no %s here" % (name, ", ".join(missing)))
    for line in terminalreporter.config.stash[SUMMARIES]:
        terminalreporter.write_line(line)


def pytest_sessionfinish(session, exitstatus):
    runs = session.config.stash[RUNS]
    runs.shutdown(wait=False, cancel_futures=True)
    for item in getattr(session, "items", ()):  # what an interrupted run leaves
        if isinstance(item, FileInOwnProcess):
            item.end()
    session.config.stash[OTHERS_DONE].set()
    runs.shutdown()
    if session.config.option.faults_table and session.config.stash[FIGURES]:
        write_figures(session.config.option.faults_table, session.config.stash[FIGURES])
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    collected = exitstatus == 0 and reporter is not None and not session.config.option.collectonly
    if collected and not reporter.stats.get("passed"):
        session.exitstatus = 5
