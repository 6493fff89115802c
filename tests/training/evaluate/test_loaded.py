"""Tests of parameter sets loaded at the start of move_base, as from a file, and of those set by
reconfigure.
"""

import numpy as np
import pytest

from applr_ros1 import robots
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.policy.parameter_space import SPACE, space_of
from applr_ros1.policy.stall import StallRule
from training.env.settings import TrialSettings
from training.evaluate.loaded import loadable_space
from training.evaluate.runner import TrialRunner
from training.evaluate.trial import Trial

SET = {"max_vel_x": 0.9, "footprint_padding": 0.14, "min_in_place_vel_theta": 0.75, "vx_samples": 9}


@pytest.mark.parametrize(
    ("loaded", "in_maps", "slowest"), [(True, 0.1, 0.75), (False, 0.14, 0.314)]
)
def test_parameters_read_at_start_come_from_a_loaded_set_and_else_from_the_robots_files(
    loaded, in_maps, slowest, monkeypatch
):
    """A footprint padding that is loaded would also change the planner's outline, so a YAML file
    leaves it out.
    """
    bases = []
    called = []
    reconfigure = MoveBase.reconfigure

    def made(*how, **more):
        bases.append(MoveBase(*how, **more))
        return bases[-1]

    monkeypatch.setattr(
        MoveBase, "reconfigure", lambda *how: called.append(how[1]) or reconfigure(*how)
    )
    monkeypatch.setattr("training.env.settings.MoveBase", made)
    drives = TrialRunner(TrialSettings(planner="cpp-like", loaded=loaded, time_limit=2.0))
    theta = SPACE.from_dict(SET)
    drives.run(Trial("generated:7", "m", 0, 1, "generated:7", "", theta=tuple(theta.tolist())))
    (base,) = bases
    wanted = {**SPACE.as_dict(theta), "footprint_padding": in_maps}
    assert drives.drive.decisions[-1].after == wanted
    assert bool(called) != loaded
    assert drives.episode.stack.escapes != loaded
    sides = np.abs(base.local_planner.planner._footprint).max(axis=0)
    assert sides.tolist() == pytest.approx([0.21 + 0.1, 0.165 + 0.1])
    assert np.ptp(base.local_costmap.footprint, axis=0)[0] == pytest.approx(0.42 + 2 * in_maps)
    assert base.local_planner.slowest_turn == slowest


@pytest.mark.parametrize("loaded", [True, False])
def test_a_set_that_is_set_by_reconfigure_gives_way_in_a_stall_and_a_loaded_one_stays(
    loaded, monkeypatch
):
    slow = SPACE.from_dict({**SET, "max_vel_x": 0.2})
    seeds = []

    def instead(self, method, context, theta):
        return slow if method.redraws_stalled else None

    monkeypatch.setattr(StallRule, "instead", instead)
    monkeypatch.setattr(StallRule, "reset", lambda self, seed: seeds.append(seed))
    drives = TrialRunner(TrialSettings(loaded=loaded, time_limit=2.0))
    theta = tuple(SPACE.from_dict(SET).tolist())
    drives.run(Trial("generated:7", "m", 0, 5, "generated:7", "", theta=theta))
    assert drives.drive.decisions[-1].after["max_vel_x"] == (0.9 if loaded else 0.2)
    assert seeds[-1] == 5


def test_a_search_leaves_out_parameters_that_act_differently_by_reconfigure():
    jackal = loadable_space(robots.JACKAL)
    assert jackal.fixed == ("footprint_padding",)
    assert jackal.chosen.names == tuple(name for name in SPACE.names if name != "footprint_padding")
    sets = np.array([SPACE.from_dict(SET), SPACE.theta0])
    filled = [jackal.fill(theta) for theta in jackal.chosen_of(sets)]
    assert jackal.as_dict(filled[0])["footprint_padding"] == 0.1
    assert filled[1].tolist() == SPACE.theta0.tolist()
    waffle = robots.load("turtlebot3_waffle_pi")
    assert loadable_space(waffle).chosen.names == space_of(waffle).names
    burger = robots.load("turtlebot3_burger")
    assert "footprint_padding" in loadable_space(burger).chosen.names, (
        "DWAPlannerROS reads it in every cycle"
    )
