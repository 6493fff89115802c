"""The picture of a comparison of learning variants: what time costs in smoothness, changes and clearance.

compare_variants.py calls it.
"""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any, Dict, Sequence

from applr_ros1.common.files import write_bytes
from training.report.figures import COLORS, DPI, canvas

AXES = {
    "jerk": "mean |jerk| [m/s³]",
    "switching": "change of parameters per decision",
    "clearance_m": "median smallest range [m]",
    "contact": "share of trials with a contact",
}  # figure of a row -> what it is


def draw_variants(path: Path, rows: Sequence[Dict[str, Any]]) -> None:
    """A dot for each variant: its mean time against each figure of AXES, joined where names differ in a number.

    The dot of the first variant is black.

    Args:
        path: of the PNG file.
        rows: with "variant", "time_s" and AXES. Variants such as switch_2 and switch_5 are one curve, in their order,
            which begins at the first variant.
    """
    families: Dict[str, list] = {}
    for row in rows[1:]:
        family = re.sub(r"_[\d.]+$", "", str(row["variant"]))
        families.setdefault(family, [rows[0]] if family != row["variant"] else []).append(row)
    figure, axes = canvas(len(AXES), size=(4.2, 3.8), sharey=True)
    for ax, (name, label) in zip(axes[0], AXES.items()):
        for color, (family, line) in zip(COLORS * len(families), families.items()):
            x, y = [row[name] for row in line], [row["time_s"] for row in line]
            ax.plot(x, y, "o-", ms=4, lw=1, color=color, label=family)
        ax.plot(rows[0][name], rows[0]["time_s"], "ko", ms=4)
        for row in rows:
            ax.annotate(
                row["variant"], (row[name], row["time_s"]), fontsize=7, xytext=(3, 3), textcoords="offset points"
            )
        ax.set(xlabel=label)
        ax.margins(x=0.3)  # for the names, which stand at the right of their dots
        ax.grid(alpha=0.25)
    axes[0][0].set(ylabel="mean time of successful trials [s]")
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI)
    write_bytes(path, buffer.getvalue())
