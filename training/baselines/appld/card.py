"""The card beside an APPLD file: what made it, its contexts and how well they fit. appld.py writes it."""

from __future__ import annotations

from applr_ros1.policy.parameter_space import SPACE
from training.baselines.appld.classifier import HIDDEN

SCRIPT = "python -m training.demonstrate {bag} --world {world} --simulator {simulator} --seed {seed}"
SCRIPTED = "A demonstration by a script is no person's: it knows the map, and its taste in speed is ours."


def card(log) -> str:
    """Markdown, from the log that appld.py writes."""
    scripts = [SCRIPT.format(**d) for d in log["demonstrations"] if {"world", "simulator", "seed"} <= set(d)]
    lines = [
        "# APPLD: contexts and parameters from demonstrations",
        "",
        "Method `appld:FILE` of evaluate.py, and launch mode `appld`. Made by",
        "",
    ]
    lines += ["    " + command for command in scripts + [log["command"]]]
    lines += ["", "from:", ""] + ["- " + _shown(d) for d in log["demonstrations"]] + [""]
    lines += [SCRIPTED, ""] if scripts else []
    lines += ["| context | %s | rms of v, w (θ₀) |" % " | ".join(SPACE.names), "|---" * (len(SPACE) + 2) + "|"]
    lines += [_row(c) for c in log["contexts"]]
    lines += [
        "",
        "A context's name tells it from the others by the medians of speed and room, no more. rms: the "
        "planner's commands about the demonstrated ones, over %s instants of 50 ms, the planner put in the "
        "demonstrator's place each time." % " + ".join(str(c["instants"]) for c in log["contexts"]),
        "",
    ]
    found = log["classifier"]
    unseen = "none" if found["held_out"] is None else "%.1f %%" % (100.0 * found["held_out"])
    lines += [
        "Classifier: 720 beams → %d → %d, numpy at run time. It is right in %.1f %% of the instants it learnt "
        "from; trained without every fifth two seconds, in %s of those."
        % (HIDDEN, len(log["contexts"]), 100.0 * found["accuracy"], unseen),
        "",
    ]
    return "\n".join(lines)


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
