"""`./applr barn CHECKOUT`: the BARN Challenge's own runner, unmodified, against the simulator of this repository.

Every run is one process of run.py with a ROS master of its own on a free port; several run at a time. What is done
stands in OUT/runs.csv and OUT/out.txt (the runner's own lines), and the same command goes on where it was stopped.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import time
import zlib
from pathlib import Path
from typing import Dict, List, Optional, Tuple

import sim_bridge
from applr_ros1.common.errors import ApplrError, UsageError, run_main
from applr_ros1.common.files import write_bytes

from . import barn_run, mode_files, processes
from .barn_checkout import STATIC_WORLDS, WORLDS, Overlay
from .barn_results import LIMIT, Results, Run, run_of, summary

START_UP = 150.0  # wall seconds that a run may take beside the drive
GIVEN = ("APPLR_MODE", "APPLR_METHOD")  # variables of the environment that this package's controllers read
ATTEMPTS = 2  # a run whose runner fails is started so often
Job = Tuple[int, int]  # world, trial


class BarnError(ApplrError):
    """Some runs could not be driven. One line."""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = argparse.ArgumentParser(
        prog="./applr barn",
        description="Runs the BARN Challenge's own run.py, unmodified, from a checkout of the Challenge's repository, "
        "with the simulator of this repository in place of Gazebo. The same command continues a stopped evaluation.",
    )
    made.add_argument("checkout", type=Path, metavar="CHECKOUT", help="Folder with run.py and jackal_helper/ in it.")
    for name, default, kind, text in (
        ("--worlds", "0-299", str, "Numbers such as 0-49,300: BARN's worlds are 0-299, DynaBARN's 300-359"),
        ("--trials", 1, int, "Runs of each world"),
        ("--out", Path("barn_results"), Path, "Folder of the results"),
        ("--jobs", max(1, (os.cpu_count() or 2) // 2), int, "Runs at a time; by default half the processor cores"),
        ("--real-time-factor", 1.0, float, "Simulated seconds per second of real time"),
        ("--seed", 0, int, "Seed of the simulator's noise"),
    ):
        made.add_argument(name, default=default, type=kind, help=text + " (default: %(default)s).")
    made.add_argument(
        "--controller",
        type=Path,
        metavar="LAUNCH",
        help="Launch file that starts the controller, in place of the checkout's launch/move_base_DWA.launch.",
    )
    made.add_argument(
        "--simulator",
        choices=sim_bridge.NAMES,
        default="pybullet",
        help="Simulator in place of Gazebo (default: %(default)s).",
    )
    return made


def numbers(text: str) -> List[int]:
    """The worlds of a list such as 0-4,300. Raises UsageError."""
    found: List[int] = []
    for part in text.split(","):
        match = re.match(r"^(\d{1,3})(?:-(\d{1,3}))?$", part.strip(), re.ASCII)
        first, last = (int(match.group(1)), int(match.group(2) or match.group(1))) if match else (1, 0)
        if not first <= last < WORLDS:
            raise UsageError("--worlds %s: give numbers from 0 to %d, such as 0-49,300" % (text, WORLDS - 1))
        found += range(first, last + 1)
    return list(dict.fromkeys(found))


class Evaluation:
    """All runs of one command."""

    def __init__(self, options: argparse.Namespace):
        self.options = options
        self.worlds = numbers(options.worlds)
        for name, value in (("--trials", options.trials), ("--jobs", options.jobs)):
            if value < 1:
                raise UsageError("%s %d: give 1 or more" % (name, value))
        if not 0.0 < options.real_time_factor < 1000.0:
            raise UsageError("--real-time-factor %g: give a number above 0" % options.real_time_factor)
        self.out = options.out.resolve()
        (self.out / "logs").mkdir(parents=True, exist_ok=True)
        self.given = {name: mode_files.absolute(os.environ[name]) for name in GIVEN if os.environ.get(name)}
        self.overlay = Overlay(options.checkout, self.out / "overlay", options.controller)
        self._check_settings()
        self.results = Results(self.out)
        if any(world >= STATIC_WORLDS for world in self.worlds):
            for problem in self.overlay.make_table():
                print("not understood: %s" % problem, file=sys.stderr)
        self.routes = {world: self.overlay.route(world) for world in self.worlds}
        self.failed: Dict[Job, str] = {}

    def _check_settings(self) -> None:
        """What would mix two evaluations in one folder is refused."""
        options = self.options
        settings = {
            "checkout": str(self.overlay.checkout),
            "controller": str(options.controller.resolve()) if options.controller else None,
            "simulator": options.simulator,
            "seed": options.seed,
            **{name: self.given.get(name) for name in GIVEN},
        }
        path = self.out / "settings.json"
        if path.exists():
            before = json.loads(path.read_text(encoding="utf-8"))
            for name, value in settings.items():
                if before.get(name) != value:
                    raise UsageError(
                        "%s holds runs with %s %s, not %s: give another --out"
                        % (self.options.out, name, before.get(name), value)
                    )
        write_bytes(path, json.dumps(settings, indent=2).encode())

    def run(self) -> None:
        """Drive what is not done yet, several at a time."""
        todo = [
            (world, trial)
            for trial in range(self.options.trials)
            for world in self.worlds
            if (world, trial) not in self.results.runs
        ]
        total, began, done = len(todo), time.monotonic(), 0
        print("%d runs to do, %d done before, %d at a time" % (total, len(self.results.runs), self.options.jobs))
        attempts: Dict[Job, int] = {}
        running: Dict[Job, Tuple[subprocess.Popen, int]] = {}
        try:
            while todo or running:
                while todo and len(running) < self.options.jobs:
                    job = todo.pop(0)
                    attempts[job] = attempts.get(job, 0) + 1
                    running[job] = self._start(job, {port for _, port in running.values()})
                time.sleep(0.1)
                for job, (process, _) in list(running.items()):
                    if process.poll() is None:
                        continue
                    del running[job]
                    run, problem = self._result(job, process.returncode)
                    if run is None and attempts[job] < ATTEMPTS:
                        print("world %d trial %d: %s; once more" % (*job, problem), flush=True)
                        todo.append(job)
                        continue
                    done += 1
                    left = (time.monotonic() - began) / done * (total - done)
                    if run is None:
                        self.failed[job] = problem
                        text = "not driven: %s" % problem
                    else:
                        text = "%s %.1f s, score %.3f" % (run.outcome, run.time_s, run.score)
                    when = "about %d min left" % (left / 60.0 + 1.0) if done < total else "done"
                    print("[%d/%d] world %d trial %d: %s; %s" % (done, total, *job, text, when), flush=True)
        finally:
            for process, _ in running.values():
                process.terminate()
            for process, _ in running.values():
                process.wait(20.0)

    def _files(self, job: Job) -> Tuple[Path, Path]:
        name = "world_%d_trial_%d" % job
        return self.out / "logs" / (name + ".out"), self.out / "logs" / (name + ".log")

    def _start(self, job: Job, taken) -> Tuple[subprocess.Popen, int]:
        port = processes.free_port()
        while port in taken:
            port = processes.free_port()
        out, log = self._files(job)
        if out.exists():
            out.unlink()
        options = self.options
        environment = dict(
            os.environ,
            ROS_MASTER_URI="http://127.0.0.1:%d" % port,
            ROS_IP="127.0.0.1",
            ROS_LOG_DIR=str(self.out / "logs" / "ros"),
            ROS_PACKAGE_PATH=os.pathsep.join(
                [str(self.overlay.package), str(self.overlay.checkout), os.environ.get("ROS_PACKAGE_PATH", "")]
            ),
            PYTHONUNBUFFERED="1",
            **self.given,
            APPLR_SIMULATOR=options.simulator,
            APPLR_SEED=str(zlib.crc32(b"%d %d %d" % (options.seed, *job)) & 0x7FFFFFFF),
            APPLR_REAL_TIME_FACTOR=repr(options.real_time_factor),
        )
        for name in ("ROS_HOSTNAME", "ROS_NAMESPACE"):  # of another robot
            environment.pop(name, None)
        patience = START_UP + LIMIT / options.real_time_factor
        runner = [sys.executable, str(self.overlay.runner), "--world_idx", str(job[0]), "--out", str(out)]
        process = subprocess.Popen(
            [sys.executable, "-m", barn_run.__name__, repr(patience), str(log), *runner],
            env=environment,
            cwd=self.overlay.checkout,
            stdin=subprocess.DEVNULL,
            start_new_session=True,
        )
        return process, port

    def _result(self, job: Job, status: int) -> Tuple[Optional[Run], str]:
        """The finished run, or None and why there is none."""
        out, log = self._files(job)
        lines = out.read_text(encoding="utf-8", errors="replace").splitlines() if out.exists() else []
        if lines:
            run = run_of(lines[-1], job[1], self.routes[job[0]])
            if run.world == job[0]:
                with open(self.out / "out.txt", "a", encoding="utf-8") as file:
                    file.write(lines[-1] + "\n")
                self.results.add(run)
                return run, ""
        if status == barn_run.TOO_LONG:
            return None, "the runner did not end (%s)" % log
        said = [line.strip() for line in log.read_text(errors="replace").splitlines() if line.strip()]
        last = said[-1][-160:] if said else "it said nothing"
        return None, "the runner ended with status %d: %s (%s)" % (status, last, log)


def main(arguments: Optional[List[str]] = None) -> int:
    """Exit status 0: all runs are driven, whatever their outcome. 1: some could not be. 130: stopped by Ctrl-C."""
    return run_main(lambda: _main(parser().parse_args(arguments)), "barn")


def _main(options: argparse.Namespace) -> int:
    evaluation = Evaluation(options)
    try:
        evaluation.run()
    except KeyboardInterrupt:
        raise KeyboardInterrupt("stopped; the same command goes on from here") from None
    asked = [evaluation.results.runs.get((w, t)) for w in evaluation.worlds for t in range(options.trials)]
    driven = [run for run in asked if run is not None]
    if driven:
        found = summary(driven)
        write_bytes(evaluation.out / "summary.json", (json.dumps(found, indent=2) + "\n").encode())
        print("results: %s" % evaluation.out)
        print(json.dumps(found))
    if evaluation.failed:
        raise BarnError("%d of %d runs could not be driven; the same command tries them again"
                        % (len(evaluation.failed), len(asked)))  # fmt: skip
    return 0
