"""Makes a dataset of recorded drives, and trains a policy from it, offline.

`./applr demo method:=random record:=$PWD/drive.bag` records a drive in simulation, `record:=drive.bag` of the launch
file one of a real robot.
"""

import argparse
import subprocess
import sys
from pathlib import Path


def main() -> None:
    """Convert, train."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bags", nargs="+", help="recorded drives")
    parser.add_argument("--gradient-steps", default="300", help="gradient steps (default %(default)s)")
    parser.add_argument("--net-arch", nargs="+", default=["256", "256"], help="hidden layers (default 256 256)")
    parser.add_argument("--out", default="offline", help="folder to write; must be new (default %(default)s)")
    options = parser.parse_args()

    dataset, run = str(Path(options.out) / "dataset"), str(Path(options.out) / "run")
    convert = [sys.executable, "-m", "training.bags_to_dataset", *options.bags, "--out", dataset, "--finish", "5.925"]
    train = [sys.executable, "-m", "training.train", "--dataset", dataset, "--out", run, "--eval-worlds", "none"]
    train += ["--gradient-steps", options.gradient_steps, "--net-arch", *options.net_arch, "--bc-alpha", "2.5"]
    for command in (convert, train):
        subprocess.run(command, check=True)
    print(f"{run}/actor.safetensors: drive it with method:=applr policy:=...")


if __name__ == "__main__":
    main()
