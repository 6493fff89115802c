#!/usr/bin/env python3
"""Measures the speeds in docs/explanation/results.md: `python tests/benchmarks/run.py [--json] [--only NAME ...]`.

Each figure is a function of its own name in one of the modules beside this file, returning (value, unit). Measure on a
machine that does nothing else.
"""

import argparse
import importlib
import json
import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[2])]
FIGURES = {  # name -> module beside this file, in the order in which they are measured
    "planner_cycle_default": "control",
    "planner_cycle_max": "control",
    "dwa_planner_cycle": "control",
    "inflation": "cycle",
    "navfn": "cycle",
    "control_cycle": "cycle",
    "sim_speed_kinematic": "cycle",
    "sim_speed_pybullet": "cycle",
    "td3_updates": "learning",
    "sb3_td3_updates": "learning",
    "actor_inference": "learning",
    "reconfigure_all": "reconfigure",
    "way_of_scan": "ways",
    "way_of_decision": "ways",
    "way_of_transition": "ways",
}


def measure(name):
    """{"value": ..., "unit": ...} of one figure."""
    value, unit = getattr(importlib.import_module("tests.benchmarks." + FIGURES[name]), name)()
    return {"value": round(float(value), 3), "unit": unit}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="one JSON object instead of a line per figure")
    parser.add_argument(
        "--only",
        nargs="+",
        choices=list(FIGURES),
        default=list(FIGURES),
        metavar="NAME",
        help="measure these: " + ", ".join(FIGURES),
    )
    options = parser.parse_args()
    figures = {}
    for name in options.only:
        try:
            figures[name] = measure(name)
        except Exception as problem:  # the others are still worth having
            figures[name] = {"value": None, "unit": "failed: %s" % (str(problem).splitlines() or [repr(problem)])[0]}
        if not options.json:
            print("%-28s %s %s" % (name, figures[name]["value"], figures[name]["unit"]), flush=True)
    if options.json:
        print(json.dumps(figures, indent=2))
    return any(figure["value"] is None for figure in figures.values())


if __name__ == "__main__":
    sys.exit(main())
