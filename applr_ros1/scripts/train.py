#!/usr/bin/env python3
"""rosrun applr_ros1 train.py: trains a parameter policy (training/train.py). See --help."""
import sys

from training.train import main

if __name__ == "__main__":
    sys.exit(main())
