#!/usr/bin/env python3
"""The picture of the parameters for RViz; see applr_ros1/nodes/parameter_panel.py."""

from applr_ros1.common.errors import run_script

if __name__ == "__main__":
    run_script("applr_ros1.nodes.parameter_panel", node=True)
