"""Tests of the search for one parameter set: races between candidates on common trials, and
pruning.
"""

import numpy as np

from applr_ros1.policy.parameter_space import SPACE
from training.evaluate.compare import clearly_worse
from training.evaluate.periodic import CHOOSING
from training.evaluate.trial import Result, seed_of
from training.tune.search import plan_sets, prune_parameters, race


def run(worse_by, blocks, halve=False, noise=3.0):
    """Race candidates; candidate i is worse_by[i] [s] slower than the best. Times differ much more
    between worlds.
    """
    rng = np.random.default_rng(1)
    worlds = rng.uniform(10.0, 100.0, 1000)
    noises = rng.normal(0.0, noise, (len(worse_by), 1000))
    driven = []

    def drive(racing, block):
        driven.append((list(racing), list(block)))
        return [(worlds[block] + noises[i, block] + worse_by[i]).tolist() for i in racing]

    ranking = race(drive, np.arange(len(worse_by)), blocks, float, halve)
    return [one.place for one in ranking], [one.results for one in sorted(ranking)], driven


def test_clearly_worse_candidates_drop_out_and_close_ones_stay():
    blocks = [range(i, i + 10) for i in range(0, 50, 10)]
    ranking, results, driven = run([0.2, 30.0, 0.0, 12.0], blocks)
    assert driven[0][0] == [0, 1, 2, 3]
    assert all(set(racing) == {0, 2} for racing, _ in driven[1:])
    assert [len(of_one) for of_one in results] == [50, 10, 50, 10]
    assert ranking[2:] == [3, 1]
    assert ranking[0] == int(np.argmin([np.mean(r) if len(r) == 50 else np.inf for r in results]))


def test_halving_keeps_the_better_half_after_each_block():
    ranking, results, driven = run(
        [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0], [[0, 1], [2, 3], [4, 5]], halve=True, noise=0.0
    )
    assert [sorted(racing) for racing, _ in driven] == [[0, 1, 2, 3, 4, 5, 6], [0, 1, 2, 3], [0, 1]]
    assert ranking == [0, 1, 2, 3, 4, 5, 6]


def test_the_next_block_is_requested_when_the_last_is_driven():
    begun = []

    def blocks():
        for number in range(9):
            begun.append(number)
            yield [number]
            if number == 2:
                return

    _, results, driven = run([0.0, 0.1], blocks())
    assert begun == [0, 1, 2]
    assert [len(of_one) for of_one in results] == [3, 3]


def time_of(result):
    return result.time_s


WORLDS = [(f"w{i}", "") for i in range(8)]


def run_with(drive):
    """Return a function that evaluates sets in the worlds of a block with drive(trials)."""

    def run(sets, block):
        plan = plan_sets(SPACE, WORLDS, sets, block, 0, "kinematic")
        results = drive([trial for of_set in plan for trial in of_set])
        return [[results[trial] for trial in of_set] for of_set in plan]

    return run


def test_parameters_without_a_saving_are_reverted_to_their_defaults():
    """Four parameters matter: two save 5 s and 1 s, the third costs time, and the fourth saves only
    with the third.
    """
    names = ["max_vel_x", "sim_time", "occdist_scale", "inflation_radius"]
    at = [SPACE.names.index(name) for name in names]

    def drive(trials):
        results = {}
        for trial in trials:
            pays, little, harms, with_it = (np.array(trial.theta)[at] != SPACE.theta0[at]).tolist()
            seconds = (
                30.0
                - 5.0 * pays
                - little
                + 2.0 * harms
                - 3.0 * (with_it and harms)
                + trial.seed % 9
            )
            results[trial] = Result(True, time_s=seconds + 0.01 * (trial.seed % 3) * pays)
        return results

    theta = SPACE.to_theta(SPACE.to_action(SPACE.theta0) * 0.5)
    blocks = [list(range(8))]
    pruned, worth = prune_parameters(SPACE, run_with(drive), theta, lambda: blocks, time_of)
    changed = [
        name for name, value, default in zip(SPACE.names, pruned, SPACE.theta0) if value != default
    ]
    assert sorted(changed) == sorted(worth)
    assert {"max_vel_x", "sim_time"} <= set(worth) <= set(names)
    assert "vx_samples" not in worth
    assert worth["sim_time"][0] == worth["sim_time"][3] == 1.0
    assert 4.9 < worth["max_vel_x"][1] <= worth["max_vel_x"][2] < 5.1


def test_one_failure_does_not_revert_a_parameter_that_makes_most_drives_faster():
    theta = SPACE.theta0.copy()
    at = SPACE.names.index("max_vel_x")
    theta[at] = 1.0

    def set_after(faster):
        """Prune a set whose one change fails in one of eight worlds, and saves `faster` [s] in each
        of the others.
        """

        def drive(trials):
            saved = {
                trial: (-30.0 if trial.world == "w0" else faster) * (trial.theta[at] == 1.0)
                for trial in trials
            }
            return {trial: Result(True, time_s=20.0 - seconds) for trial, seconds in saved.items()}

        return prune_parameters(SPACE, run_with(drive), theta, lambda: [list(range(8))], time_of)[0]

    for faster, value in (
        (1.0, 1.0),
        (0.06, 1.0),
        (0.04, SPACE.theta0[at]),
        (-1.0, SPACE.theta0[at]),
    ):
        assert set_after(faster)[at] == value


def test_the_test_is_paired_one_sided_and_needs_some_trials():
    worlds = np.random.default_rng(0).uniform(0.0, 100.0, 12)
    assert clearly_worse(worlds + np.linspace(0.5, 1.5, 12), worlds)
    assert not clearly_worse(worlds, worlds + np.linspace(0.5, 1.5, 12))
    assert not clearly_worse(worlds[::-1], worlds)
    assert not clearly_worse(worlds, worlds)
    assert not clearly_worse(worlds[:4] + 50.0, worlds[:4])


def test_a_search_never_uses_the_seeds_of_evaluate():
    ((searched,),) = plan_sets(SPACE, [("w", "w")], [SPACE.theta0], [0], 3, "kinematic")
    assert searched.seed == seed_of(CHOOSING + 3, "w", 0)
    assert searched.seed not in {
        seed_of(seed, "w", trial) for seed in range(2000) for trial in range(20)
    }
