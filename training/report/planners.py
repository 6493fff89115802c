"""The table that puts several evaluations side by side: kinds of planner, the monitor.

page.py writes it where further evaluations are given.
"""

from __future__ import annotations

from typing import List, Sequence

import numpy as np

from applr_ros1.common.errors import ApplrError
from training.report import statistics
from training.report.data import SETS, Results
from training.report.table import Table
from training.report.tables import NONE, _number, _span


def planners(evaluations: Sequence[Results]) -> Table:
    """A row for each planner, set of worlds and method.

    Args:
        evaluations: the results of each planner.

    Raises:
        ApplrError: where the evaluations were driven under different protocols or in different simulators.
    """
    table = Table(
        "planners",
        "All planners",
        ["planner", "worlds", "method", "time [s]", "95 % interval", "gain [%]"]
        + ["success [%]", "collided [%]", "trials"],
    )
    for name in ("protocol", "simulator"):
        values = {str(results.settings.get(name)) for results in evaluations}
        if len(values) > 1:
            raise ApplrError("evaluations of different %ss do not compare: %s" % (name, ", ".join(sorted(values))))
    for results in evaluations:
        for name in SETS:
            worlds = results.of_set(name)
            for method in results.methods if worlds else []:
                table.rows.append(_row(results, name, worlds, method))
    table.notes = ["Times are means over the successful trials; the gain is over the baseline with the same planner."]
    return table


def _row(results: Results, name: str, worlds: List[str], method: str) -> List[str]:
    mean, low, high = statistics.mean_time(results, method, worlds)
    success, collided = (results.pooled(method, worlds, field) for field in ("success", "collided"))
    gain = NONE
    if method != results.baseline:
        gain = _number(100 * statistics.gain(results, method, worlds)[0], 1)
    return [
        results.planner,
        name,
        method,
        _number(mean),
        _span(low, high),
        gain,
        _number(100 * float(np.mean(success)), 1),
        _number(100 * float(np.mean(collided)), 1),
        str(len(success)),
    ]
