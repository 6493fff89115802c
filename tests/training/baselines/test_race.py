"""Races between candidates on common trials (training/baselines/race.py), and the file of trials of a search."""

import numpy as np

from training.baselines.race import clearly_worse, race


def run(worse_by, blocks, halve=False, noise=3.0):
    """A race in which candidate i is worse_by[i] seconds slower than the best; worlds differ by far more than that."""
    rng = np.random.default_rng(1)
    worlds, own = rng.uniform(10.0, 100.0, 1000), rng.normal(0.0, noise, (len(worse_by), 1000))
    driven = []

    def drive(racing, block):
        driven.append((list(racing), list(block)))
        return np.array([worlds[block] + own[i, block] + worse_by[i] for i in racing])

    return race(drive, len(worse_by), blocks, halve), driven


def test_clearly_worse_candidates_drop_out_and_close_ones_stay():
    blocks = [range(i, i + 10) for i in range(0, 50, 10)]
    result, driven = run([0.2, 30.0, 0.0, 12.0], blocks)
    assert driven[0][0] == [0, 1, 2, 3]
    assert all(set(racing) == {0, 2} for racing, _ in driven[1:])
    assert [len(scores) for scores in result.scores] == [50, 10, 50, 10]
    assert result.ranking[2:] == [3, 1]
    assert result.ranking[0] == int(np.argmin([s.mean() if len(s) == 50 else np.inf for s in result.scores]))


def test_halving_keeps_the_better_half_after_each_block():
    result, driven = run([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0], [[0, 1], [2, 3], [4, 5]], halve=True, noise=0.0)
    assert [sorted(racing) for racing, _ in driven] == [[0, 1, 2, 3, 4, 5, 6], [0, 1, 2, 3], [0, 1]]
    assert result.ranking == [0, 1, 2, 3, 4, 5, 6]


def test_the_test_is_paired_one_sided_and_needs_some_trials():
    worlds = np.random.default_rng(0).uniform(0.0, 100.0, 12)
    assert clearly_worse(worlds + np.linspace(0.5, 1.5, 12), worlds)
    assert not clearly_worse(worlds, worlds + np.linspace(0.5, 1.5, 12))
    assert not clearly_worse(worlds[::-1], worlds)
    assert not clearly_worse(worlds, worlds)
    assert not clearly_worse(worlds[:4] + 50.0, worlds[:4])
