#!/usr/bin/env python3
"""Makes a dataset for offline training of recorded drives (training/bags_to_dataset.py)."""

import sys

sys.path.pop(0)  # this file's folder, whose sim_bridge.py would hide the package of that name

from training.bags_to_dataset import main

if __name__ == "__main__":
    sys.exit(main())
