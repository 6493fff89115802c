"""`./applr barn CHECKOUT`: the BARN Challenge's own runner with this repository's simulator.

The runner is not modified.

Each run is one process of run.py with its own ROS master on a free port. The runner takes worlds,
plugins and launch files from the ROS package jackal_helper. `link_package` creates a copy of this
package with links into the checkout, except for two launch files: Gazebo's launch file starts this
repository's simulator, and the controller's launch file is the user's if --controller is given.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import List, Optional

from applr_ros1.common.errors import ApplrError
from applr_ros1.policy import methods

from .launcher import free_port

HELPER = "jackal_helper"
GAZEBO_LAUNCH = "gazebo_launch.launch"
CONTROLLER_LAUNCH = "move_base_DWA.launch"
STATIC_WORLDS = 300  # number of BARN's worlds, 0 to 299; 300 to 359 are DynaBARN's
OURS = Path(__file__).resolve().parents[3] / "compat" / HELPER / "launch"
RUN_S = 600.0  # longest wall time of a run, which takes at most 100 s of simulated time [s]
INTERRUPT_S = 20.0  # wall time in which roslaunch ends its nodes after an interrupt [s]
METHOD = "APPLR_METHOD"  # environment variable with the method of this package's controllers


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    arguments = argparse.ArgumentParser(
        prog="./applr barn",
        description="Run the BARN Challenge's own run.py, unmodified, from a checkout of the "
        "Challenge's repository, with the simulator of this repository in place of Gazebo.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    add = arguments.add_argument
    add("checkout", type=Path, metavar="CHECKOUT", help="Folder with run.py and jackal_helper/.")
    worlds_help = "Worlds, such as 0-49,300: 0-299 are BARN's, 300-359 DynaBARN's."
    add("--worlds", default="0-299", help=worlds_help)
    add("--trials", default=1, type=int, help="Number of runs of each world.")
    add("--out", default=Path("barn_results"), type=Path, help="Folder for the results.")
    controller_help = "Launch file that replaces the checkout's launch/move_base_DWA.launch."
    add("--controller", type=Path, help=controller_help)
    return arguments


def numbers(text: str) -> List[int]:
    """Parse a list of worlds such as 0-4,300.

    Raises:
        ApplrError: It is no list of numbers and ranges.
    """
    worlds: List[int] = []
    for world_range in text.split(","):
        try:
            bounds = [int(number) for number in world_range.split("-")]
        except ValueError:
            raise ApplrError(f"--worlds {text}: give numbers and ranges such as 0-49,300") from None
        worlds += range(bounds[0], bounds[-1] + 1)
    return worlds


def link_package(checkout: Path, folder: Path, controller: Optional[Path]) -> Path:
    """Create a linked copy of the checkout's package jackal_helper in `folder`.

    An old copy is replaced.

    controller: Launch file of the controller, None for the checkout's own.

    Raises:
        ApplrError: A file is missing.
    """
    launch_files = {GAZEBO_LAUNCH: OURS / GAZEBO_LAUNCH}
    if controller is not None:
        launch_files[CONTROLLER_LAUNCH] = controller
    required_paths = (checkout / "run.py", checkout / HELPER / "worlds", *launch_files.values())
    for required_path in required_paths:
        if not required_path.exists():
            advice = "give a checkout of the BARN Challenge, and a launch file"
            raise ApplrError(f"{required_path} does not exist: {advice}")
    # The runner finds everything below the package's name, so that links are enough.
    package = folder / HELPER
    shutil.rmtree(package, ignore_errors=True)
    shutil.copytree(checkout / HELPER, package, copy_function=os.symlink)
    for launch_name, launch_file in launch_files.items():
        link = package / "launch" / launch_name
        link.unlink(missing_ok=True)
        link.symlink_to(launch_file.resolve())
    return package


def run(checkout: Path, package: Path, world: int, trial: int, out: Path) -> None:
    """Run run.py once. It appends its result to out.txt, and its output goes to the logs."""
    environment = dict(os.environ)
    for variable_name in ("ROS_HOSTNAME", "ROS_NAMESPACE"):  # These may be set for another robot.
        environment.pop(variable_name, None)
    environment.update(
        ROS_MASTER_URI=f"http://127.0.0.1:{free_port()}",
        ROS_IP="127.0.0.1",
        ROS_LOG_DIR=str(out / "logs" / "ros"),
        ROS_PACKAGE_PATH=f"{package}:{checkout}:{os.environ.get('ROS_PACKAGE_PATH', '')}",
        APPLR_SEED=str(trial),
    )
    command = [sys.executable, "run.py", "--world_idx", str(world), "--out", str(out / "out.txt")]
    # In a session of its own, the runner and all its nodes can be ended together.
    with open(_log(out, world, trial), "wb") as log_file:
        runner = subprocess.Popen(
            command,
            env=environment,
            cwd=checkout,
            stdout=log_file,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    # The runner may hang, and its processes may outlive it.
    try:
        runner.wait(RUN_S)
    except subprocess.TimeoutExpired:
        pass  # The run counts as one without a result.
    finally:
        end(runner)


def _log(out: Path, world: int, trial: int) -> Path:
    return out / "logs" / f"world_{world}_trial_{trial}.log"


def end(runner: "subprocess.Popen[bytes]") -> None:
    """End a runner and what remains of its group, first with an interrupt for roslaunch."""
    group = runner.pid
    deadline = time.monotonic() + INTERRUPT_S
    # Signal 0 only asks whether a process of the group still exists.
    with contextlib.suppress(ProcessLookupError):
        os.killpg(group, signal.SIGINT)
        while time.monotonic() < deadline:
            time.sleep(0.1)
            runner.poll()  # A runner that has ended would stay in its group until then.
            os.killpg(group, 0)
        os.killpg(group, signal.SIGKILL)


def main() -> None:
    """Execute all runs.

    Raises:
        ApplrError: An option is invalid or, at the end, runs have no result.
    """
    options = parser().parse_args()
    checkout = options.checkout.resolve()
    out_folder = options.out.resolve()
    results = out_folder / "out.txt"
    worlds = numbers(options.worlds)
    if results.exists():
        raise ApplrError(f"{results} exists already: give another --out")
    package = link_package(checkout, out_folder / "package", options.controller)
    for world in worlds:
        world_file = f"BARN/world_{world}.world"
        if world >= STATIC_WORLDS:
            world_file = f"DynaBARN/world_{world - STATIC_WORLDS}.world"
        if not (package / "worlds" / world_file).exists():
            problem = f"the checkout has no world {world}, {world_file}"
            raise ApplrError(f"--worlds {options.worlds}: {problem}")
    (out_folder / "logs").mkdir(exist_ok=True)
    # The runner's processes run in the checkout, where a relative path would not be found.
    if METHOD in os.environ:
        os.environ[METHOD] = methods.absolute(os.environ[METHOD])

    # The worlds come round in each trial, so that an interrupted evaluation has all of them.
    result_count = 0
    for trial in range(options.trials):
        for world in worlds:
            run(checkout, package, world, trial, out_folder)
            result_lines = results.read_text().splitlines() if results.exists() else []
            result = f"no result, see {_log(out_folder, world, trial)}"
            if len(result_lines) > result_count:
                result = result_lines[-1]
            result_count = len(result_lines)
            print(f"world {world} trial {trial}: {result}", flush=True)
    run_count = len(worlds) * options.trials
    if result_count < run_count:
        problem = f"{run_count - result_count} of {run_count} runs have no result"
        raise ApplrError(f"{problem}: see the logs in {out_folder}/logs")
