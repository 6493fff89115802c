"""`./applr barn CHECKOUT`: the BARN Challenge's own runner, unmodified, against the simulator of this repository.

Every run is one process of run.py with a ROS master of its own on a free port; several run at a time. The runner leaves
ROS nodes behind: what a run has started is found by a variable of its environment, and ended with it. What is done
stands in OUT/logs, one file of the runner's own line per run, and the same command goes on where it was stopped.

The runner looks for the ROS package jackal_helper: worlds, plugins and launch files. `Overlay` makes a folder of that
name whose files are links into the checkout, but for the launch file that starts Gazebo (ours starts the simulator of
this repository) and the one that starts the controller (the person's, if one is given).
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import zlib
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from typing import Dict, List, Optional, Tuple

import numpy as np
import psutil

import sim_bridge
import worlds
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import read_json, write_bytes, write_json
from applr_ros1.policy import methods
from worlds import barn

from .launcher import free_port

HELPER = "jackal_helper"
GAZEBO_LAUNCH, CONTROLLER_LAUNCH = "gazebo_launch.launch", "move_base_DWA.launch"
STATIC_WORLDS = 300  # worlds 0 to 299 are BARN's, 300 to 359 DynaBARN's
WORLDS = 360
OURS = Path(__file__).resolve().parents[3] / "compat" / HELPER / "launch"
LIMIT_S = 100.0  # s of simulated time for a run
SPEED_MPS = 2.0  # m/s at which the optimal time is driven
START_UP_S = 150.0  # s of wall time that a run may take beside the drive
METHOD = "APPLR_METHOD"  # variable of the environment that this package's controllers read
RUN = "APPLR_BARN_RUN"  # variable by which the processes of a run are found: the runner's file
ATTEMPTS = 2  # a run whose runner fails is started so often
Job = Tuple[int, int]  # world, trial
MEANS = {  # name in summary.json: column of runs.csv
    **{"success_rate": "success", "collision_rate": "collided", "timeout_rate": "timeout", "time_s": "time_s"},
    **{"score": "score", "score_2024": "score_2024", "metric_of_runner": "metric"},
}


def parser() -> argparse.ArgumentParser:
    """Return the command line."""
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
        ("--controller", None, Path, "Launch file of the controller, for the checkout's launch/move_base_DWA.launch"),
        ("--simulator", "pybullet", str, f"Simulator in place of Gazebo, {' or '.join(sim_bridge.NAMES)}"),
    ):
        choices = sim_bridge.NAMES if name == "--simulator" else None
        made.add_argument(name, default=default, type=kind, choices=choices, help=text + " (default: %(default)s).")
    return made


def numbers(text: str) -> List[int]:
    """Return the worlds of a list such as 0-4,300. Raises ApplrError."""
    found: List[int] = []
    for part in text.split(","):
        match = re.match(r"^(\d{1,3})(?:-(\d{1,3}))?$", part.strip(), re.ASCII)
        first, last = (int(match.group(1)), int(match.group(2) or match.group(1))) if match else (1, 0)
        if not first <= last < WORLDS:
            raise ApplrError(f"--worlds {text}: give numbers from 0 to {WORLDS - 1}, such as 0-49,300")
        found += range(first, last + 1)
    return list(dict.fromkeys(found))


class Overlay:
    """The package jackal_helper of a checkout, made anew in `folder`, with its own controller if that is None."""

    def __init__(self, checkout: Path, folder: Path, controller: Optional[Path]):
        self.checkout = Path(os.path.realpath(checkout))
        self.runner = self.checkout / "run.py"
        self.package = folder / HELPER
        helper = self.checkout / HELPER
        for needed in (self.runner, helper / "package.xml", helper / "worlds"):
            if not needed.exists():
                raise ApplrError(f"{checkout} is no checkout of the BARN Challenge: it has no {needed.name}")
        if controller is not None and not controller.is_file():
            raise ApplrError(f"controller {controller} is not there: give a launch file")
        shutil.rmtree(self.package, ignore_errors=True)
        shutil.copytree(helper, self.package, copy_function=os.symlink)
        launch = self.package / "launch"
        launch.mkdir(exist_ok=True)
        for name, file in ((GAZEBO_LAUNCH, OURS / GAZEBO_LAUNCH), (CONTROLLER_LAUNCH, controller)):
            if file is not None:
                if (launch / name).exists():
                    (launch / name).unlink()
                (launch / name).symlink_to(file.resolve())
        if not (launch / CONTROLLER_LAUNCH).exists():
            raise ApplrError(f"{helper} has no launch/{CONTROLLER_LAUNCH}: give --controller LAUNCH")

    def route(self, number: int) -> float:
        """Return the length [m] of the Challenge's reference path in a world, from which its optimal time follows."""
        static = number < STATIC_WORLDS
        name = f"BARN/world_{number}.world" if static else f"DynaBARN/world_{number - STATIC_WORLDS}.world"
        path = self.package / "worlds" / name
        if not path.is_file():
            raise ApplrError(f"the checkout has no world {number}: {path.name} is missing")
        course = worlds.load(str(path)).course
        return (barn.challenge_course(course.path) if static else course).route_m


@dataclass(frozen=True)
class Run:
    """One row: what the runner wrote (time_s and metric), and the score computed from it."""

    world: int
    trial: int
    success: int
    collided: int
    timeout: int
    time_s: float
    metric: float  # as run.py computes it
    score: float  # with no less than 2 optimal times counted, as run.py does since 2025
    score_2024: float  # no less than 4, as until then
    optimal_s: float

    @property
    def outcome(self) -> str:
        """In a word."""
        return "succeeded" if self.success else "collided" if self.collided else "timeout"


def score(success: bool, seconds: float, optimal: float, least: float) -> float:
    """Return the Challenge's score of a run: success x OT / clip(AT, `least` OT, 8 OT), 0 to 1 / `least`; times [s]."""
    return float(success) * optimal / float(np.clip(seconds, least * optimal, 8.0 * optimal))


def run_of(line: str, trial: int, route: float) -> Run:
    """Return the Run of the line that run.py writes: world, success, collided, timeout, seconds, metric."""
    words = line.split()
    try:
        world, success, collided, timeout = (int(word) for word in words[:4])
        seconds, metric = (float(word) for word in words[4:6])
    except ValueError:
        raise ApplrError(f"the runner wrote {line[:80]!r}: no line of six numbers") from None
    optimal = route / SPEED_MPS
    scores = [round(score(bool(success), seconds, optimal, least), 4) for least in (2.0, 4.0)]
    return Run(world, trial, success, collided, timeout, seconds, metric, scores[0], scores[1], round(optimal, 4))


def summary(runs: List[Run]) -> Dict[str, object]:
    """Counts, rates and means over all runs; times over the successful ones."""
    found: Dict[str, object] = {"runs": len(runs), "worlds": len({run.world for run in runs})}
    for name, field in MEANS.items():
        values = [getattr(run, field) for run in runs if run.success or field != "time_s"]
        found[name] = round(float(np.mean(values)), 4) if values else None
    return found


class Evaluation:
    """All runs of one command."""

    def __init__(self, options: argparse.Namespace):
        self.options = options
        self.worlds = numbers(options.worlds)
        if min(options.trials, options.jobs) < 1:
            raise ApplrError(f"--trials {options.trials} --jobs {options.jobs}: give 1 or more of each")
        if not 0.0 < options.real_time_factor < 1000.0:
            raise ApplrError(f"--real-time-factor {options.real_time_factor:g}: give a number above 0")
        self.out = Path(os.path.realpath(options.out))
        (self.out / "logs").mkdir(parents=True, exist_ok=True)
        self.method = methods.absolute(os.environ[METHOD]) if os.environ.get(METHOD) else None
        self.overlay = Overlay(options.checkout, self.out / "overlay", options.controller)
        self._check_settings()
        self.routes = {world: self.overlay.route(world) for world in self.worlds}
        self.jobs: List[Job] = [(world, trial) for trial in range(options.trials) for world in self.worlds]
        self.failed: Dict[Job, str] = {}
        self._stopped = False

    def _check_settings(self) -> None:
        """Refuse what would mix two evaluations in one folder."""
        options = self.options
        settings = {
            "checkout": str(self.overlay.checkout),
            "controller": str(options.controller.resolve()) if options.controller else None,
            "simulator": options.simulator,
            "seed": options.seed,
            METHOD: self.method,
        }
        path = self.out / "settings.json"
        before = read_json(path) if path.exists() else settings
        for name, value in settings.items():
            if before.get(name) != value:
                there = f"{options.out} holds runs with {name} {before.get(name)}"
                raise ApplrError(f"{there}, not {value}: give another --out")
        write_json(path, settings)

    def done(self) -> Dict[Job, Run]:
        """Return the runs of this command that have been driven, by their files."""
        found = {job: self._run_of(job) for job in self.jobs}
        return {job: run for job, run in found.items() if run is not None}

    def run(self) -> None:
        """Drive what is not done yet, several at a time."""
        before, began = self.done(), time.monotonic()
        todo = [job for job in self.jobs if job not in before]
        print(f"{len(todo)} runs to do, {len(before)} done before, {self.options.jobs} at a time", flush=True)
        with ThreadPoolExecutor(self.options.jobs) as pool:
            try:
                futures = {pool.submit(self._drive, job): job for job in todo}
                for number, future in enumerate(as_completed(futures), 1):
                    world, trial = futures[future]
                    left = (time.monotonic() - began) / number * (len(todo) - number) / 60.0
                    came = f"world {world} trial {trial}: {future.result()}; about {left:.0f} min left"
                    print(f"[{number}/{len(todo)}] {came}", flush=True)
            finally:
                self._stopped = True

    def _drive(self, job: Job) -> str:
        """Drive one run in a thread of the pool, again where its runner fails; returns its result in words."""
        for _ in range(ATTEMPTS):
            if self._stopped:
                return "stopped"
            problem = self._attempt(job)
            run = self._run_of(job)
            if run is not None:
                return f"{run.outcome} {run.time_s:.1f} s, score {run.score:.3f}"
        self.failed[job] = problem
        return f"not driven: {problem}"

    def _file(self, job: Job, ending: str) -> Path:
        return self.out / "logs" / f"world_{job[0]}_trial_{job[1]}.{ending}"

    def _run_of(self, job: Job) -> Optional[Run]:
        """Return the run that the runner's line in the job's file states; None without a whole one."""
        try:
            lines = self._file(job, "out").read_text(encoding="utf-8", errors="replace").splitlines()
            run = run_of(lines[-1], job[1], self.routes[job[0]])
        except (OSError, IndexError, ApplrError):
            return None
        return run if run.world == job[0] else None

    def _attempt(self, job: Job) -> str:
        """Start the runner and wait until it has ended. Returns why it left no line, where it left none."""
        out, log, options = self._file(job, "out"), self._file(job, "log"), self.options
        if out.exists():
            out.unlink()
        packages = self.overlay.package, self.overlay.checkout, os.environ.get("ROS_PACKAGE_PATH", "")
        environment = {key: text for key, text in os.environ.items() if key not in ("ROS_HOSTNAME", "ROS_NAMESPACE")}
        environment.update(
            ROS_MASTER_URI=f"http://127.0.0.1:{free_port()}",
            ROS_IP="127.0.0.1",
            ROS_LOG_DIR=str(self.out / "logs" / "ros"),
            ROS_PACKAGE_PATH=os.pathsep.join(map(str, packages)),
            PYTHONUNBUFFERED="1",
            APPLR_SIMULATOR=options.simulator,
            APPLR_SEED=str(zlib.crc32(b"%d %d %d" % (options.seed, *job)) & 0x7FFFFFFF),
            APPLR_REAL_TIME_FACTOR=repr(options.real_time_factor),
            **{RUN: str(out), **({METHOD: self.method} if self.method else {})},
        )
        runner = [sys.executable, str(self.overlay.runner), "--world_idx", str(job[0]), "--out", str(out)]
        with open(log, "wb") as file:
            process = subprocess.Popen(
                runner,
                env=environment,
                cwd=self.overlay.checkout,
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        deadline = time.monotonic() + START_UP_S + LIMIT_S / options.real_time_factor
        while process.poll() is None and not self._stopped and time.monotonic() < deadline:
            time.sleep(0.1)
        late = process.poll() is None
        _end_all(str(out))
        if late:
            process.wait()
            return "stopped" if self._stopped else f"the runner did not end ({log})"
        lines = [line.strip() for line in log.read_text(errors="replace").splitlines() if line.strip()]
        last = lines[-1][-160:] if lines else "it printed nothing"
        return f"the runner ended with status {process.returncode}: {last} ({log})"

    def write(self) -> None:
        """Write out.txt, runs.csv and summary.json of the runs that are done."""
        runs = list(self.done().values())
        text = io.StringIO()
        table = csv.writer(text, lineterminator="\n")
        table.writerow(field.name for field in fields(Run))
        table.writerows(astuple(run) for run in runs)
        write_bytes(self.out / "runs.csv", text.getvalue().encode())
        lines = [self._file((run.world, run.trial), "out").read_text(encoding="utf-8").splitlines()[-1] for run in runs]
        write_bytes(self.out / "out.txt", "".join(line + "\n" for line in lines).encode())
        if runs:
            found = summary(runs)
            write_json(self.out / "summary.json", found)
            print(f"results: {self.out}")
            print(json.dumps(found))


def _end_all(run: str, patience: float = 8.0) -> None:
    """End the processes of a run: SIGINT first, SIGKILL for what is left after `patience` [s]."""
    _signal(run, signal.SIGINT)
    deadline = time.monotonic() + patience
    while _signal(run, 0):
        if time.monotonic() > deadline:
            _signal(run, signal.SIGKILL)
        time.sleep(0.1)


def _signal(run: str, number: int) -> bool:
    """Send a signal to the living processes of a run, 0 for none; whether there are any."""
    found = False
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            if process.environ().get(RUN) == run and process.status() != psutil.STATUS_ZOMBIE:
                found = True
                process.send_signal(number)
    return found


def main() -> None:
    """Drive all runs, whatever their outcome. Raises ApplrError that says how many could not be driven."""
    evaluation = Evaluation(parser().parse_args())
    try:
        evaluation.run()
    except KeyboardInterrupt:
        raise KeyboardInterrupt("stopped; the same command goes on from here") from None
    finally:
        evaluation.write()
    if evaluation.failed:
        missing = f"{len(evaluation.failed)} of {len(evaluation.jobs)} runs"
        raise ApplrError(f"{missing} could not be driven; the same command tries them again")
