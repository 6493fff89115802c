"""Converts recorded drives to a dataset, and trains a policy from it offline.

`record:=drive.bag` of the launch file records a drive of a real robot, `./applr demo method:=explore record:=drive.bag`
a drive in simulation. Without a bag, this program records some drives with parameters around the robot's defaults.
"""

import argparse
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def record(bag: Path, courses: int, decisions: int) -> None:
    """Drive `courses` built-in worlds for at most `decisions` decisions each, and record them as a robot would."""
    sys.path.insert(0, str(ROOT))  # for tests.support
    import sim_bridge
    import worlds
    from applr_ros1.planner.move_base import MoveBase
    from applr_ros1.policy import methods
    from applr_ros1.robots import JACKAL
    from tests.support.recording import RecordingEpisode, StackWriter

    defaults = methods.make("dwa")
    assert isinstance(defaults, methods.FixedParameters)
    explore = methods.Exploration(defaults)
    with StackWriter(bag) as writer:
        simulator, planner = sim_bridge.make("kinematic"), MoveBase(JACKAL.parameters())
        episode = RecordingEpisode(simulator, planner, writer, period=explore.period, limit=decisions)
        for number in range(courses):
            outcome = episode.reset(worlds.load(f"generated:{number}"), seed=number)
            explore.reset(number)
            while not outcome.over:
                outcome = episode.decide(explore.theta(None))


def main() -> None:
    """Convert the bags to a dataset, and train; without bags, record some first."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bags", nargs="*", type=Path, help="recorded drives (default: three drives in simulation)")
    parser.add_argument("--gradient-steps", default="300", help="gradient steps (default %(default)s)")
    parser.add_argument("--net-arch", nargs="+", default=["256", "256"], help="hidden layers (default 256 256)")
    parser.add_argument("--out", default="offline", help="folder to write; must be new (default %(default)s)")
    options = parser.parse_args()

    if not options.bags:
        Path(options.out).mkdir(parents=True)
        options.bags = [Path(options.out) / "drives.bag"]
        record(options.bags[0], courses=3, decisions=20)
    dataset, run = str(Path(options.out) / "dataset"), str(Path(options.out) / "run")
    convert = ["applr_ros1.training.bags_to_dataset", *map(str, options.bags), "--recipe", "offline", "--out", dataset]
    convert += ["--finish", "5.925"]  # progress at the end of a built-in course [m]
    train = ["applr_ros1.training.train", "--recipe", "offline", "--dataset", dataset, "--out", run, "--seeds", "1"]
    train += ["--init-from", "dwa", "--gradient-steps", options.gradient_steps, "--net-arch", *options.net_arch]
    for command in (convert, train):
        subprocess.run([sys.executable, "-m", *command], check=True)
    print(f"{run}/actor.safetensors: drive it with method:=FILE")


if __name__ == "__main__":
    main()
