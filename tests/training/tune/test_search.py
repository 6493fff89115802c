"""Tests of the search for one parameter set: generations, races between candidates on common
trials, pruning, and the settings of its drives.
"""

import itertools
from types import SimpleNamespace
from typing import List, NamedTuple, Tuple

import numpy as np
import pytest

from applr_ros1 import robots
from applr_ros1.policy.parameter_space import SPACE, ParameterSet
from applr_ros1.robots import JACKAL
from sim_bridge.simulator import Randomisation
from training.attempts.verdict import clearly_worse
from training.evaluate.periodic import CHOOSING
from training.evaluate.runner import TrialWorld
from training.evaluate.trial import Result, seed_of
from training.tune import best_set
from training.tune.search import Raced, plan_sets, prune_parameters, race, search


class RecordedRace:
    """Race in which candidate i is worse_by[i] [s] slower than the best. Times differ much more
    between worlds.

    Attributes:
        ranking: Candidates, best first.
        results: Results of each candidate.
        racing: Candidates that drove each block.
    """

    def __init__(self, worse_by, blocks, halve=False, noise=3.0):
        # Seconds of a world, and of a candidate in it, for up to 1,000 worlds.
        rng = np.random.default_rng(1)
        self._worse_by = np.array(worse_by)
        self._world_times = rng.uniform(10.0, 100.0, 1000)
        self._noise = rng.normal(0.0, noise, (len(worse_by), 1000))
        self.racing = []
        candidates = np.arange(len(worse_by))
        self.ranking = []
        self.results = [None] * len(worse_by)
        for raced_set in race(self._drive, candidates, blocks, float, halve):
            self.ranking.append(raced_set.place)
            self.results[raced_set.place] = raced_set.results

    def _drive(self, candidates, block):
        self.racing.append(candidates.tolist())
        noise = self._noise[candidates][:, block]
        worse_by = self._worse_by[candidates, np.newaxis]
        times = self._world_times[block] + noise + worse_by
        return times.tolist()


def test_clearly_worse_candidates_drop_out_and_close_ones_stay():
    blocks = np.arange(50).reshape(5, 10)
    # Candidates 0 and 2 differ by less than the noise of 3 s.
    raced = RecordedRace([0.2, 30.0, 0.0, 12.0], blocks)
    assert raced.racing[0] == [0, 1, 2, 3]
    for racing in raced.racing[1:]:
        assert sorted(racing) == [0, 2]
    assert list(map(len, raced.results)) == [50, 10, 50, 10]
    # The faster of the two close ones leads, and those that dropped out follow.
    first, second, *others = raced.ranking
    assert {first, second} == {0, 2}
    assert np.mean(raced.results[first]) < np.mean(raced.results[second])
    assert others == [3, 1]


def test_halving_keeps_the_better_half_after_each_block():
    blocks = [[0, 1], [2, 3], [4, 5]]
    raced = RecordedRace(
        [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0],
        blocks,
        halve=True,
        noise=0.0,
    )
    first_block, second_block, third_block = raced.racing
    assert sorted(first_block) == [0, 1, 2, 3, 4, 5, 6]
    assert sorted(second_block) == [0, 1, 2, 3]
    assert sorted(third_block) == [0, 1]
    assert raced.ranking == [0, 1, 2, 3, 4, 5, 6]


def test_the_next_block_is_requested_when_the_last_is_driven():
    begun_blocks = []

    def blocks():
        for number in range(9):
            begun_blocks.append(number)
            yield [number]
            if number == 2:
                return

    raced = RecordedRace([0.0, 0.1], blocks())
    assert begun_blocks == [0, 1, 2]
    assert list(map(len, raced.results)) == [3, 3]


# Places of the eight sets of a generation, best set first. The order is not its own inverse.
BEST_FIRST = [3, 5, 0, 1, 7, 2, 6, 4]
STARTS = [SPACE.theta0, 0.5 * (SPACE.theta0 + SPACE.high)]


class Searched(NamedTuple):
    """Search of two generations.

    Attributes:
        driven: Sets (k, 8), block and seed of each call that drives.
        told: Candidates and ranks that CMA-ES gets after each generation.
        winners: Winner of each generation.
    """

    driven: List[Tuple[np.ndarray, List[int], int]]
    told: List[Tuple[list, list]]
    winners: List[Raced]


@pytest.fixture
def searched(monkeypatch):
    """Return a search of two generations of eight sets, with eight of ten worlds per set."""
    from cma import CMAEvolutionStrategy

    driven = []
    told = []
    costs = {}  # by parameter set

    def run(sets, block, seed):
        if len(sets) == len(BEST_FIRST):  # A generation begins.
            costs.clear()
            for place, theta in enumerate(sets):
                costs[tuple(theta)] = BEST_FIRST.index(place)
        driven.append((sets, block, seed))
        return [[costs[tuple(theta)]] * len(block) for theta in sets]

    tell = CMAEvolutionStrategy.tell

    def noted(strategy, candidates, ranks):
        told.append((list(candidates), ranks))
        tell(strategy, candidates, ranks)

    monkeypatch.setattr(CMAEvolutionStrategy, "tell", noted)
    options = {"sigma": 0.3, "population": 8, "worlds_per_set": 8}
    generations = search(SPACE, 10, [run, run], STARTS, float, seed=4, **options)
    winners = [winner for winner, _ in generations]
    return Searched(driven, told, winners)


def test_a_generation_races_through_two_quarters_and_then_half_of_its_worlds(searched):
    assert [len(block) for _, block, _ in searched.driven] == [2, 2, 4] * 2
    assert [len(sets) for sets, _, _ in searched.driven] == [8, 4, 2] * 2
    seeds = [seed for _, _, seed in searched.driven]
    assert seeds == [1004] * 3 + [1005] * 3

    # Each generation has worlds of its own, and drives each of them once.
    blocks = [block for _, block, _ in searched.driven]
    first_worlds = sum(blocks[:3], [])
    second_worlds = sum(blocks[3:], [])
    assert len(set(first_worlds)) == len(set(second_worlds)) == 8
    assert first_worlds != second_worlds


def test_the_starting_sets_are_driven_in_the_first_generation(searched):
    first_sets, _, _ = searched.driven[0]
    candidates, _ = searched.told[0]
    for start, theta, candidate in zip(STARTS, first_sets, candidates):
        assert theta.tolist() == SPACE.clip(start).tolist()
        assert candidate == pytest.approx(SPACE.to_action(start))

    second_sets, _, _ = searched.driven[3]
    distances = np.abs(second_sets[:, np.newaxis] - STARTS).max(axis=2)
    assert distances.min() > 0.0


def test_cma_es_gets_the_rank_of_each_set(searched):
    for (_, ranks), winner in zip(searched.told, searched.winners):
        assert [ranks[place] for place in BEST_FIRST] == [0, 1, 2, 3, 4, 5, 6, 7]
        assert winner.place == BEST_FIRST[0]


def time_of(result):
    """Return the cost of a trial, its time [s]."""
    return result.time_s


WORLDS = [(f"w{i}", "") for i in range(8)]
BLOCKS = [list(range(8))]


def run_with(drive):
    """Return a function that evaluates sets in the worlds of a block with drive(trials)."""

    def run(sets, block):
        plan = plan_sets(SPACE, WORLDS, sets, block, 0, "kinematic")
        results = drive(itertools.chain(*plan))
        results_of_sets = []
        for trials_of_set in plan:
            results_of_sets.append([results[trial] for trial in trials_of_set])
        return results_of_sets

    return run


def test_parameters_without_a_saving_are_reverted_to_their_defaults():
    """Four parameters matter: two save 5 s and 1 s, the third costs time, and the fourth saves only
    with the third.
    """

    def drive(trials):
        results = {}
        for trial in trials:
            changed = changed_names(trial.theta)
            seconds = 30.0 + trial.seed % 9
            if "max_vel_x" in changed:
                seconds += 0.01 * (trial.seed % 3) - 5.0
            if "sim_time" in changed:
                seconds -= 1.0
            if "occdist_scale" in changed:
                seconds += 2.0
                if "inflation_radius" in changed:
                    seconds -= 3.0
            results[trial] = Result(True, time_s=seconds)
        return results

    # Halfway from the defaults to the middle of each range: every parameter is changed.
    half_action = SPACE.to_action(SPACE.theta0) * 0.5
    pruned, effects = prune_parameters(
        SPACE,
        run_with(drive),
        SPACE.to_theta(half_action),
        lambda: BLOCKS,
        time_of,
    )
    assert changed_names(pruned) == set(effects)
    assert {"max_vel_x", "sim_time"} <= set(effects)
    assert set(effects) <= {"max_vel_x", "sim_time", "occdist_scale", "inflation_radius"}
    assert effects["sim_time"].mean == pytest.approx(1.0)
    assert effects["sim_time"].median == pytest.approx(1.0)
    effect_of_speed = effects["max_vel_x"]
    assert 4.9 < effect_of_speed.low <= effect_of_speed.high < 5.1


def changed_names(theta):
    """Return the names of the parameters of a set that are not the defaults."""
    is_changed = theta != SPACE.theta0
    return set(itertools.compress(SPACE.names, is_changed))


@pytest.mark.parametrize(
    ("saving", "names"),
    [
        (1.0, {"max_vel_x"}),
        (0.06, {"max_vel_x"}),
        (0.04, set()),
        (-1.0, set()),
    ],
)
def test_one_failure_does_not_revert_a_parameter_that_makes_most_drives_faster(saving, names):
    """The change costs 30 s in one of eight worlds, and saves `saving` [s] in each of the
    others.
    """

    def drive(trials):
        results = {}
        for trial in trials:
            seconds = 20.0
            if changed_names(trial.theta):
                if trial.world == "w0":
                    seconds += 30.0
                else:
                    seconds -= saving
            results[trial] = Result(True, time_s=seconds)
        return results

    theta = SPACE.theta0.copy()
    theta[SPACE.names.index("max_vel_x")] = 1.0
    pruned, _ = prune_parameters(
        SPACE,
        run_with(drive),
        theta,
        lambda: BLOCKS,
        time_of,
    )
    assert changed_names(pruned) == names


def test_the_test_is_paired_one_sided_and_needs_some_trials():
    costs = np.random.default_rng(0).uniform(0.0, 100.0, 12)
    a_little_more = costs + np.linspace(0.5, 1.5, 12)
    assert clearly_worse(a_little_more, costs)
    assert not clearly_worse(costs, a_little_more)
    assert not clearly_worse(costs[::-1], costs)
    assert not clearly_worse(costs, costs)
    assert not clearly_worse(costs[:4] + 50.0, costs[:4])


def test_a_search_never_uses_the_seeds_of_evaluate():
    ((searched,),) = plan_sets(SPACE, [("w", "w")], [SPACE.theta0], [0], 3, "kinematic")
    assert searched.seed == seed_of(CHOOSING + 3, "w", 0)
    # Seeds and trials that people use.
    for seed, trial in itertools.product(range(2000), range(20)):
        assert searched.seed != seed_of(seed, "w", trial)


def test_drives_of_a_search_may_take_ten_optimal_times_of_the_longest_course():
    def time_limit(*lengths):
        """Return the time limit [s] in worlds with routes of some lengths [m]."""
        listed = []
        for length in lengths:
            world = SimpleNamespace(course=SimpleNamespace(route_m=length))
            listed.append(TrialWorld("w", "w", world))
        return best_set.drives_of(JACKAL, listed).time_limit

    # The Jackal drives 8 m in 4 s.
    assert time_limit(5.0, 8.0, 6.0) == 40.0
    # No trial may take longer than those of evaluate.py.
    assert time_limit(30.0) == 100.0


def test_everything_but_the_ground_is_randomised_in_the_drives_of_a_search():
    world = SimpleNamespace(course=SimpleNamespace(route_m=8.0))
    settings = best_set.drives_of(JACKAL, [TrialWorld("w", "w", world)])
    nominal = vars(Randomisation())
    randomised = set()
    for name, value in vars(Randomisation(**settings.randomisation)).items():
        if value != nominal[name]:
            randomised.add(name)
    assert randomised == set(nominal) - {"ground"}


def test_the_obstacle_range_of_another_robots_set_is_scaled_by_size():
    space = best_set.search_space(JACKAL)
    waffle = robots.load("turtlebot3_waffle_pi")
    theta = np.zeros(0)  # only the range matters

    def range_of(obstacle_range):
        """Return the range [m] for the Jackal of a range in a set for the waffle."""
        parameter_set = ParameterSet(theta, obstacle_range=obstacle_range)
        action = best_set.range_action(parameter_set, waffle, space, JACKAL)
        return space.to_theta(np.full(len(space), action))[-1]

    assert waffle.world_scale < 0.7
    assert range_of(2.0) == pytest.approx(2.0 / waffle.world_scale)
    # The Jackal's files have 2.5 m.
    assert range_of(None) == pytest.approx(2.5)
