"""The search around a policy: what a shift does, what the fit of pairs finds, and the command."""

import json

import numpy as np
import pytest

pytest.importorskip("torch")

from safetensors.numpy import save_file

from applr_ros1.policy.actor import Actor, save
from applr_ros1.policy.network import Mirror, forward, layers_of, mirrored, with_mirror_images
from tests.support.trial_tables import kept
from training import refine_policy
from training.actors.tasks import Trial, TrialResult
from training.policy_file import weights_of
from training.refinement import search as search_module
from training.refinement.directions import Directions, hidden
from training.refinement.driving import ShiftedRunner
from training.refinement.search import SearchOptions, search, towards
from training.refinement.slopes import CURVATURE, fit

BEAMS, INPUTS, PARAMETERS = 720, 729, 8
MIRROR = Mirror.of(BEAMS, 9)


def network(rng, units=12):
    """A random policy with two hidden layers, whose outputs stay within +-1 or so."""
    sizes, weights = (INPUTS, units, units, PARAMETERS), {}
    for i, (width, out) in enumerate(zip(sizes[:-1], sizes[1:])):
        weights["%d.weight" % i] = (rng.normal(size=(out, width)) / np.sqrt(width)).astype(np.float32)
        weights["%d.bias" % i] = (0.1 * rng.normal(size=out)).astype(np.float32)
    return weights


def answers(weights, observations):
    """The outputs before tanh."""
    return forward(layers_of(weights, INPUTS, PARAMETERS, "network"), observations)


@pytest.mark.parametrize("networks", [1, 2])
def test_a_shift_adds_constants_and_multiples_of_the_components(networks):
    rng = np.random.default_rng(networks)
    weights = with_mirror_images(network(rng), MIRROR) if networks > 1 else network(rng)
    observations = rng.uniform(-1.0, 1.0, (50, INPUTS)).astype(np.float32)
    directions = Directions.found(weights, observations, MIRROR, 2)
    coefficients = rng.normal(size=(PARAMETERS, 3))
    components = (hidden(weights, observations) - directions.mean) @ directions.basis.T
    expected = answers(weights, observations) + coefficients[:, 0] + components @ coefficients[:, 1:].T
    shifted = directions.shifted(weights, coefficients)
    np.testing.assert_allclose(answers(shifted, observations), expected, atol=2e-5)
    assert all(shifted[name].dtype == np.float32 for name in weights)


def test_components_have_a_variance_of_one_and_leave_a_symmetric_policy_symmetric():
    rng = np.random.default_rng(3)
    weights = with_mirror_images(network(rng), MIRROR)
    seen = rng.uniform(-1.0, 1.0, (80, INPUTS)).astype(np.float32)
    directions = Directions.found(weights, seen, MIRROR, 3)
    components = (hidden(weights, seen) - directions.mean) @ directions.basis.T
    np.testing.assert_allclose(np.cov(components.T, bias=True), np.eye(3), atol=1e-3)
    shifted = directions.shifted(weights, rng.normal(size=(PARAMETERS, 4)))
    np.testing.assert_allclose(answers(shifted, seen), answers(mirrored(shifted, MIRROR), seen), atol=1e-5)


def pairs(rng, count, slopes, curvature, noise, centre):
    """Shifts, centres and half the differences of noisy scores of a quadratic function."""
    shifts = 0.3 * rng.normal(size=(count, len(slopes)))
    centres = np.tile(centre, (count, 1))
    halves = shifts @ slopes + curvature * (shifts * centres).sum(axis=1) + noise * rng.normal(size=count)
    return shifts, centres, halves


def test_the_fit_finds_slopes_and_curvature():
    rng, slopes = np.random.default_rng(5), np.array([1.0, -2.0, 0.0, 0.5])
    first, second = pairs(rng, 400, slopes, 1.2, 0.3, np.zeros(4)), pairs(rng, 400, slopes, 1.2, 0.3, -slopes)
    found = fit(*(np.concatenate(both) for both in zip(first, second)), np.zeros(4, int))
    np.testing.assert_allclose(found.slopes, slopes, atol=0.2)
    assert found.curvature == pytest.approx(1.2, abs=0.1)
    assert found.noise == pytest.approx(0.3, abs=0.03)
    assert np.all(np.abs(found.slopes - slopes) < 5.0 * found.errors)
    np.testing.assert_allclose(found.best, -slopes / 1.2, atol=0.3)
    assert found.gain(found.best) == pytest.approx(slopes @ slopes / 2.4, abs=0.4)


def test_the_fit_believes_no_slope_that_noise_explains():
    rng = np.random.default_rng(6)
    shifts, centres, halves = pairs(rng, 300, np.zeros(32), 2.0, 3.0, np.zeros(32))
    plain = np.linalg.lstsq(shifts, halves, rcond=None)[0]
    found = fit(shifts, centres, halves, np.zeros(32, int))
    assert np.linalg.norm(found.slopes) < 0.5 * np.linalg.norm(plain)
    assert found.curvature == pytest.approx(CURVATURE[0])  # nothing was said about it


def test_a_group_without_slopes_takes_nothing_from_another():
    """Two coefficients with slopes beside thirty without: each group has its own belief."""
    rng, slopes = np.random.default_rng(9), np.append([1.5, -1.0], np.zeros(30))
    drawn = pairs(rng, 300, slopes, 2.0, 2.0, np.zeros(32))
    apart = fit(*drawn, np.repeat([0, 1], [2, 30]))
    together = fit(*drawn, np.zeros(32, int))
    assert apart.spread[0] > 5.0 * apart.spread[1]
    assert np.linalg.norm(apart.slopes - slopes) < 0.7 * np.linalg.norm(together.slopes - slopes)


def test_a_centre_moves_no_farther_than_it_may():
    np.testing.assert_allclose(towards(np.array([3.0, 4.0]), np.zeros(2), 1.0), [0.6, 0.8])
    np.testing.assert_allclose(towards(np.array([3.0, 4.0]), np.array([3.0, 3.5]), 1.0), [3.0, 4.0])
    np.testing.assert_allclose(towards(np.ones(2), np.ones(2), 1.0), np.ones(2))


class Bowl:
    """Instead of drives: the score is a bowl around `lowest`, some drives fail, and all are remembered."""

    lowest = np.array([0.8, -0.6, 0.0])

    def __init__(self):
        self.rng, self.worlds = np.random.default_rng(7), []

    def run(self, trials):
        results = {}
        for trial in trials:
            self.worlds.append(trial.world)
            way = np.array(json.loads(trial.method_spec)) - self.lowest
            time_s = 8.0 + way @ way + 0.5 * self.rng.normal()
            results[trial] = TrialResult(success=self.rng.random() > 0.01, time_s=time_s, collided=False)
        return results


def made(world, coefficients):
    """A trial."""
    return Trial(world, "shifted", 0, 1, world, coefficients, "ours")


def test_a_search_ends_at_the_lowest_score():
    options = SearchOptions(steps=8, pairs=150, sigma=0.3, limit=20.0, contact_seconds=5.0, seed=0)
    bowl, worlds = Bowl(), ["fresh:%d" % n for n in range(1200)]
    steps = list(search(bowl, made, worlds, np.zeros(3, int), options))
    assert [step.number for step in steps] == list(range(1, 9))
    np.testing.assert_allclose(steps[-1].centre, bowl.lowest, atol=0.12)
    assert bowl.worlds == [world for world in worlds for _ in range(2)]
    assert steps[-1].score < steps[0].score - 0.5
    assert steps[-1].fit.gain(steps[-1].centre) == pytest.approx(1.0, abs=0.3)
    assert steps[-1].fit.curvature == pytest.approx(2.0, abs=0.5)


def test_what_a_failure_and_a_contact_score():
    options = SearchOptions(steps=1, pairs=2, sigma=0.3, limit=20.0, contact_seconds=5.0, seed=0)
    scores = [
        search_module._score(TrialResult(success=ok, time_s=7.0, collided=touched), options)
        for ok, touched in ((True, False), (True, True), (False, False), (False, True))
    ]
    assert scores == [7.0, 12.0, 20.0, 25.0]


@pytest.fixture
def command(tmp_path, monkeypatch):
    """A command line that drives a few short pairs."""
    monkeypatch.setattr(refine_policy, "WATCHED", 2)
    training = {"transitions": 10, "options": {"seed": 3}}
    metadata = {"period_s": 2.0, "training": training, "result": {"score": 1.0}}
    save(tmp_path / "start.safetensors", network(np.random.default_rng(8)), metadata)
    return [
        *(str(tmp_path / "start.safetensors"), "--out", str(tmp_path / "out.safetensors")),
        *("--results", str(tmp_path / "results"), "--worlds", "fresh:7-12", "--simulator", "kinematic"),
        *("--steps", "2", "--pairs", "2", "--components", "1", "--workers", "0", "--period", "1"),
    ]


def test_the_command_writes_a_policy_and_continues_where_it_was(command, tmp_path, capsys, monkeypatch):
    assert refine_policy.main(command) == 0, capsys.readouterr().err
    printed = capsys.readouterr().out
    assert "step 2 of 2: shifted policies score" in printed
    policy, start = Actor.load(tmp_path / "out.safetensors"), Actor.load(tmp_path / "start.safetensors")
    assert policy.period == 1.0
    assert "result" not in policy.metadata  # it was the given policy's
    refined = policy.metadata["training"]["refined"]
    assert (refined["worlds"], refined["step"], refined["sigma"]) == ("fresh:7-12", 2, 0.25)
    assert np.array(refined["coefficients"]).shape == (PARAMETERS, 2)
    assert policy.metadata["training"]["transitions"] == 10
    assert not np.array_equal(weights_of(policy)["2.bias"], weights_of(start)["2.bias"])
    np.testing.assert_array_equal(weights_of(policy)["1.weight"], weights_of(start)["1.weight"])
    table = tmp_path / "results" / "trials.sqlite"
    driven = kept(table)
    assert len(driven) == 8
    kept(table, first=5)
    assert refine_policy.main(command) == 0
    again = Actor.load(tmp_path / "out.safetensors")
    assert again.metadata == policy.metadata
    np.testing.assert_array_equal(weights_of(again)["2.weight"], weights_of(policy)["2.weight"])
    assert kept(table) == driven


def test_directions_are_found_once(command, tmp_path, capsys, monkeypatch):
    """Their last bits differ between machines: another one that continues the search takes those of the file."""
    short = [*command, "--steps", "1", "--limit", "2"]
    assert refine_policy.main(short) == 0
    results, once = tmp_path / "results", capsys.readouterr().out.count("for the directions")
    found_first, driven = (results / "directions.safetensors").read_bytes(), kept(results / "trials.sqlite")
    found = Directions.found.__func__

    def elsewhere(cls, *arguments):
        directions = found(cls, *arguments)
        return Directions(directions.mean * np.float32(1.0 + 1e-6), directions.basis)

    monkeypatch.setattr(Directions, "found", classmethod(elsewhere))
    assert refine_policy.main(short) == 0
    assert kept(results / "trials.sqlite") == driven
    assert (results / "directions.safetensors").read_bytes() == found_first
    assert (once, capsys.readouterr().out.count("for the directions")) == (1, 0)
    assert refine_policy.main([*short, "--components", "2"]) == 0  # another search finds its own
    assert (results / "directions.safetensors").read_bytes() != kept


def test_what_cannot_be_is_one_line_before_the_first_drive(command, tmp_path, capsys):
    before = (tmp_path / "start.safetensors").read_bytes()
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("")
    (tmp_path / "results").mkdir()
    save_file({"0.bias": np.zeros(12, np.float32)}, tmp_path / "results" / "directions.safetensors")
    for more, words in (
        (["--out", tmp_path / "folder" / ".." / "start.safetensors"], "this is the policy to begin with"),
        (["--out", tmp_path / "file" / "out.safetensors"], "cannot be made"),
        (["--steps", "3"], "fresh:7-12: these are 6, and 3 steps of 2 pairs need 8"),
        (["--robot", "husky"], "husky"),
        ([], "holds no directions"),
    ):
        assert refine_policy.main([*command, *map(str, more)]) == 1
        printed = capsys.readouterr()
        assert words in printed.err
        assert printed.err.count("\n") == 1
        assert "driving" not in printed.out
    assert (tmp_path / "start.safetensors").read_bytes() == before


def test_a_drive_ends_at_the_limit(command, tmp_path):
    """And counts as a failure that took so long."""
    runner = ShiftedRunner(policy=command[0], simulator="kinematic", time_limit=2.0)
    result = runner.run(made("fresh:7", "")).result
    assert (result.success, result.timeout, result.time_s) == (False, True, 2.0)
    assert len(runner.observations) == 1  # one decision of two seconds
