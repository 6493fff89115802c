#!/usr/bin/env python3
"""Makes a dataset for offline training of recorded drives (training/bags_to_dataset.py)."""
import sys

from training.bags_to_dataset import main

if __name__ == "__main__":
    sys.exit(main())
