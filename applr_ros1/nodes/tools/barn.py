"""`./applr barn CHECKOUT`: the BARN Challenge's own runner, unmodified, with the simulator of this repository.

Each run is one process of run.py with its own ROS master on a free port. The runner takes worlds, plugins and launch
files from the ROS package jackal_helper. `link_package` creates a copy of this package with links into the checkout,
except for two launch files: Gazebo's launch file starts this repository's simulator, and the controller's launch file
is the user's if --controller is given.
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
GAZEBO_LAUNCH, CONTROLLER_LAUNCH = "gazebo_launch.launch", "move_base_DWA.launch"
STATIC_WORLDS = 300  # number of BARN's worlds, 0 to 299; 300 to 359 are DynaBARN's
OURS = Path(__file__).resolve().parents[3] / "compat" / HELPER / "launch"
RUN_S = 600.0  # longest wall time of a run, which takes at most 100 s of simulated time [s]
METHOD = "APPLR_METHOD"  # environment variable with the method of this package's controllers


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    made = argparse.ArgumentParser(
        prog="./applr barn",
        description="Run the BARN Challenge's own run.py, unmodified, from a checkout of the Challenge's repository, "
        "with the simulator of this repository in place of Gazebo.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    add = made.add_argument
    add("checkout", type=Path, metavar="CHECKOUT", help="Folder with run.py and jackal_helper/.")
    add(
        "--worlds",
        default="0-299",
        help="Worlds, such as 0-49,300: 0-299 are BARN's, 300-359 DynaBARN's.",
    )
    add("--trials", default=1, type=int, help="Number of runs of each world.")
    add("--out", default=Path("barn_results"), type=Path, help="Folder for the results.")
    add(
        "--controller",
        type=Path,
        help="Launch file that replaces the checkout's launch/move_base_DWA.launch.",
    )
    return made


def numbers(text: str) -> List[int]:
    """Parse a list of worlds such as 0-4,300. Raises ApplrError."""
    try:
        spans = [[int(number) for number in part.split("-")] for part in text.split(",")]
    except ValueError:
        raise ApplrError(f"--worlds {text}: give numbers and ranges such as 0-49,300") from None
    return [world for span in spans for world in range(span[0], span[-1] + 1)]


def link_package(checkout: Path, folder: Path, controller: Optional[Path]) -> Path:
    """Create a linked copy of the checkout's package jackal_helper in `folder`, in place of an old copy.

    controller: Launch file of the controller, None for the checkout's own.
    """
    package = folder / HELPER
    for needed in (checkout / "run.py", checkout / HELPER / "worlds", controller or checkout):
        if not needed.exists():
            raise ApplrError(
                f"{needed} does not exist: give a checkout of the BARN Challenge, and a launch file"
            )
    shutil.rmtree(package, ignore_errors=True)
    shutil.copytree(checkout / HELPER, package, copy_function=os.symlink)
    for name, file in ((GAZEBO_LAUNCH, OURS / GAZEBO_LAUNCH), (CONTROLLER_LAUNCH, controller)):
        if file is not None:
            (package / "launch" / name).unlink(missing_ok=True)
            (package / "launch" / name).symlink_to(file.resolve())
    return package


def run(checkout: Path, package: Path, world: int, trial: int, out: Path) -> None:
    """Run run.py once. It appends its result to out.txt, and its output goes to the logs."""
    environment = {
        key: text
        for key, text in os.environ.items()
        if key not in ("ROS_HOSTNAME", "ROS_NAMESPACE")
    }
    environment.update(
        ROS_MASTER_URI=f"http://127.0.0.1:{free_port()}",
        ROS_IP="127.0.0.1",
        ROS_LOG_DIR=str(out / "logs" / "ros"),
        ROS_PACKAGE_PATH=f"{package}:{checkout}:{os.environ.get('ROS_PACKAGE_PATH', '')}",
        APPLR_SEED=str(trial),
    )
    command = [sys.executable, "run.py", "--world_idx", str(world), "--out", str(out / "out.txt")]
    with open(out / "logs" / f"world_{world}_trial_{trial}.log", "wb") as log:
        runner = subprocess.Popen(
            command,
            env=environment,
            cwd=checkout,
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    try:
        runner.wait(RUN_S)
    except subprocess.TimeoutExpired:
        pass  # The run counts as one without a result.
    finally:
        end(runner.pid)


def end(group: int) -> None:
    """End the remaining processes of a runner. roslaunch ends its nodes within 20 s of an interrupt."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(group, signal.SIGINT)
        for _ in range(200):
            time.sleep(0.1)
            os.killpg(group, 0)
        os.killpg(group, signal.SIGKILL)


def main() -> None:
    """Execute all runs. Raises ApplrError at the end if runs have no result."""
    options = parser().parse_args()
    checkout, out = options.checkout.resolve(), options.out.resolve()
    results, worlds = out / "out.txt", numbers(options.worlds)
    if results.exists():
        raise ApplrError(f"{results} exists already: give another --out")
    package = link_package(checkout, out / "package", options.controller)
    for world in worlds:
        name = (
            f"BARN/world_{world}"
            if world < STATIC_WORLDS
            else f"DynaBARN/world_{world - STATIC_WORLDS}"
        )
        if not (package / "worlds" / f"{name}.world").exists():
            raise ApplrError(
                f"--worlds {options.worlds}: the checkout has no world {world}, {name}.world"
            )
    (out / "logs").mkdir(exist_ok=True)
    if METHOD in os.environ:
        os.environ[METHOD] = methods.absolute(os.environ[METHOD])
    lines: List[str] = []
    for world, trial in [(world, trial) for trial in range(options.trials) for world in worlds]:
        run(checkout, package, world, trial, out)
        before, lines = len(lines), results.read_text().splitlines() if results.exists() else []
        result = (
            lines[-1]
            if len(lines) > before
            else f"no result, see {out}/logs/world_{world}_trial_{trial}.log"
        )
        print(f"world {world} trial {trial}: {result}", flush=True)
    missing = len(worlds) * options.trials - len(lines)
    if missing:
        raise ApplrError(
            f"{missing} of {missing + len(lines)} runs have no result: see the logs in {out}/logs"
        )
