"""The paper's parameter profiles from our trials, as values that report.js draws."""

from __future__ import annotations

from typing import Any, Dict, Iterator, List, Tuple

import numpy as np

from applr_ros1.drives.page import PageScene, Shown, parameter_values, sampled, scene_values
from training.evaluate.drives_page import shown_drives
from training.evaluate.stored import Results
from worlds.world import clearance

# Regions by the distance to the nearest obstacle, tightest first, with colours of the pages that
# colour-blind people tell apart
REGIONS = (
    ("tight (under 0.5 m)", "slow"),
    ("between (0.5 to 0.9 m)", "line"),
    ("open (over 0.9 m)", "fast"),
)
LIMITS = (0.5, 0.9)  # distances to the nearest obstacle between the regions [m]
PROFILES = 3  # largest number of methods whose parameters are drawn per world


def profiles(results: Results) -> Dict[str, Any]:
    """Return the profiles for which there are traces, as JSON values; empty if there are none.

    They are drawn for the world of median difficulty (of those with all traces) and the physical
    course.
    """
    drawn = list(_drawn(results))
    if not drawn:
        return {}
    return {
        "parameters": parameter_values(results.space),
        "regions": [{"words": region_words, "color": color} for region_words, color in REGIONS],
        "outline": results.outline.tolist(),
        "drawn": [_profile(results, *profile) for profile in drawn],
    }


def _drawn(results: Results) -> Iterator[Tuple[str, Shown]]:
    """Yield the world and the drive of each profile."""
    # Worlds in which the first trial of each method was kept, with these drives
    kept_drives: Dict[str, List[Shown]] = {}
    for world in results.worlds:
        first_drives = [shown for shown in shown_drives(results, world) if shown.trial == 0]
        if len(first_drives) == len(results.methods):
            kept_drives[world] = first_drives
    ordered = results.by_difficulty(list(kept_drives.keys() - {"physical_course"}))
    chosen = ordered[len(ordered) // 2 :][:1]
    if "physical_course" in kept_drives:
        chosen.append("physical_course")

    # A constant parameter set has no profile.
    changing: List[int] = []
    for number, method in enumerate(results.methods):
        if "parameters" not in results.settings["methods"].get(method, {}):
            changing.append(number)
    for world in chosen:
        for number in changing[:PROFILES]:
            yield world, kept_drives[world][number]


def _profile(results: Results, world_name: str, shown: Shown) -> Dict[str, Any]:
    """Return a drive with the region of each of its poses (paper, Fig. 5), as JSON values."""
    world = results.load(world_name)
    poses, _ = sampled(shown.drive)
    regions = np.digitize(clearance(world, poses[:, :2]), LIMITS)  # indices (n,) into REGIONS
    return {
        "method": results.methods[shown.method],
        "world": scene_values(PageScene(world_name, world, [shown])),
        "regions": regions.tolist(),
    }
