"""The card beside an APPLD file: what made it, its contexts and how well they fit. appld.py writes it."""

from __future__ import annotations

import textwrap
from typing import List

from training.baselines.appld.classifier import HIDDEN

SCRIPT = "python -m training.demonstrate {bag} --world {world} --simulator {simulator} --seed {seed}"
SCRIPTED = "A scripted demonstration is not a person's: the script knows the map, and its choice of speed is ours."


def card(log) -> str:
    """Markdown, from the log that appld.py writes."""
    scripts = [SCRIPT.format(**d) for d in log["demonstrations"] if {"world", "simulator", "seed"} <= set(d)]
    lines = [
        "# APPLD: contexts and parameters from demonstrations",
        "",
        "For the method `appld:FILE` of evaluate.py and the launch method `appld`. Made by",
        "",
    ]
    lines += ["    " + command for command in scripts + [log["command"]]]
    lines += (
        ["", "from:", ""] + [line for d in log["demonstrations"] for line in _wrapped("- " + _shown(d), "  ")] + [""]
    )
    lines += [SCRIPTED, ""] if scripts else []
    names = list(log["contexts"][0]["parameters"])
    lines += ["| context | %s | rms of v, w (θ₀) |" % " | ".join(names), "|---" * (len(names) + 2) + "|"]
    lines += [_row(c) for c in log["contexts"]]
    lines += [
        "",
        *_wrapped(
            "The name of a context says how the medians of its speed and free space differ from those of the others. "
            "rms is the root mean square difference between the planner's commands and the demonstrated ones, with the "
            "default parameters in parentheses, over %s instants of 50 ms; at each instant the planner is put in the "
            "demonstrator's place." % " + ".join(str(c["instants"]) for c in log["contexts"])
        ),
        "",
    ]
    found = log["classifier"]
    unseen = "no part" if found["held_out"] is None else "%.1f %%" % (100.0 * found["held_out"])
    lines += [
        *_wrapped(
            "The classifier has %d inputs (beams), %d hidden units and %d outputs. It recognises the context in "
            "%.1f %% of the instants that it was trained on, and in %s of those of every fifth two seconds when it is "
            "trained without them." % (log["beams"], HIDDEN, len(log["contexts"]), 100.0 * found["accuracy"], unseen)
        ),
        "",
    ]
    return "\n".join(lines)


def _wrapped(text: str, indent: str = "") -> List[str]:
    return textwrap.wrap(text, 119, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


def _shown(demonstration) -> str:
    said = ", ".join("%s %s" % (k, v) for k, v in demonstration.items() if k not in ("bag", "seconds"))
    return "%s: %s, %.1f s" % (demonstration["bag"], said, demonstration["seconds"])


def _row(context) -> str:
    values = " | ".join("%g" % round(v, 3) for v in context["parameters"].values())
    return "| %s | %s | %.2f m/s, %.2f rad/s (%.2f, %.2f) |" % (
        context["name"],
        values,
        *context["rms_v_w"],
        *context["rms_v_w_theta0"],
    )
