#!/usr/bin/env python3
"""Makes a dataset for offline training of recorded drives (training/bags_to_dataset.py)."""

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    run_script("training.bags_to_dataset")
