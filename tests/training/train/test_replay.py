"""Tests of the replay buffer: storage, sampling, refused data."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from applr_ros1.common.errors import ApplrError
from tests.support import training
from tests.support.seeds import examples
from training.env.trajectory import Trajectory, TransitionLayout
from training.train.learner.config import LearnerOptions
from training.train.learner.learner import draw_batch
from training.train.replay.buffer import Replay

SMALL = TransitionLayout(scan=4, rest=2, action=2)

BATCH = LearnerOptions(batch_size=64, n_step=1, gamma=0.9)


def episode(t, number=0, terminated=False):
    return training.episode(SMALL, number, t, terminated=terminated)


def test_a_stored_scan_is_exact_to_half_a_step():
    layout = TransitionLayout()
    observations = np.random.default_rng(0).uniform(-1, 1, (5, layout.size)).astype(np.float32)
    back = layout.restore(layout.quantise(observations), observations[:, layout.scan :])
    assert np.abs(back - observations)[:, :720].max() <= layout.step / 2 + 1e-6
    assert np.array_equal(back[:, 720:], observations[:, 720:])
    edges = np.zeros((1, layout.size), np.float32)
    edges[0, :3] = -1, 1, 5  # A value beyond the range is clipped, not wrapped.
    assert layout.quantise(edges)[0, :3].tolist() == [0, 255, 255]


@examples(60)
@given(
    st.lists(st.tuples(st.integers(1, 9), st.booleans()), min_size=1, max_size=12),
    st.integers(12, 40),
    st.integers(1, 5),
)
def test_samples_are_the_episodes_own_n_step_transitions(lengths, capacity, n):
    """Samples are compared with a list of episodes. The ring is overwritten several times."""
    gamma = 0.9
    replay = Replay(SMALL, capacity)
    truth = {}
    for number, (t, terminated) in enumerate(lengths):
        trajectory = episode(t, number, terminated)
        replay.add(trajectory)
        for k in range(t):
            m = min(n, t - k)
            total = sum(gamma**i * float(trajectory.reward[k + i]) for i in range(m))
            ended = terminated and k + m == t
            truth[trajectory.rest[k].tobytes()] = (
                total,
                0.0 if ended else gamma**m,
                trajectory.rest[k + m],
                trajectory.scan[k + m],
                trajectory.action[k],
                trajectory.scan[k],
            )
    rng = np.random.default_rng(0)
    rows = replay.draw(rng, 200)
    rewards, discounts, following = replay.n_step_return(rows, n, gamma)
    for row, reward, discount, after in zip(rows, rewards, discounts, following):
        total, factor, rest, scan, action, here = truth[replay.rest[row].tobytes()]
        assert reward == pytest.approx(total, abs=1e-5)
        assert discount == pytest.approx(factor)
        assert np.array_equal(replay.rest[after], rest)
        assert np.array_equal(replay.scan[after], scan)
        assert np.array_equal(replay.action[row], action)
        assert np.array_equal(replay.scan[row], here)
    assert replay.transitions == sum(t for t, _ in lengths)


def test_every_transition_is_drawn_equally_often():
    replay = Replay(SMALL, 100)
    for number, t in enumerate((1, 2, 10)):
        replay.add(episode(t, number))
    counts = np.bincount(replay.draw(np.random.default_rng(0), 130_000), minlength=16)
    assert np.count_nonzero(counts) == 13
    assert counts[counts > 0].min() > 9_600
    assert counts.max() < 10_400


def test_a_batch_has_the_transitions_of_its_rows():
    replay = Replay(SMALL, 50)
    trajectory = episode(5, terminated=True)
    replay.add(trajectory)
    batch = draw_batch(replay, np.random.default_rng(0), BATCH, torch.device("cpu"))
    observations = SMALL.restore(trajectory.scan, trajectory.rest)
    for i in range(64):
        k = int(np.argmin(np.abs(observations - batch.observation[i].numpy()).sum(1)))
        np.testing.assert_allclose(batch.observation[i], observations[k], atol=1e-6)
        np.testing.assert_allclose(batch.next_observation[i], observations[k + 1], atol=1e-6)
        assert float(batch.discount[i]) == pytest.approx(0.0 if k == 4 else 0.9)


def test_mirror_exchanges_left_and_right_in_half_of_a_batch():
    replay = Replay(SMALL, 50)
    replay.add(episode(5, terminated=True))
    both = BATCH, BATCH.model_copy(update={"mirror": True})
    plain, mirrored = (
        draw_batch(replay, np.random.default_rng(0), o, torch.device("cpu")) for o in both
    )
    for name in ("observation", "next_observation"):
        ours = getattr(mirrored, name).numpy()
        theirs = getattr(plain, name).numpy()
        np.testing.assert_array_equal(ours[32:], theirs[32:])
        np.testing.assert_array_equal(ours[:32, : SMALL.scan], theirs[:32, : SMALL.scan][:, ::-1])
        np.testing.assert_array_equal(ours[:32, SMALL.scan], -theirs[:32, SMALL.scan])
        np.testing.assert_array_equal(ours[:32, SMALL.scan + 1 :], theirs[:32, SMALL.scan + 1 :])
    for name in ("action", "reward", "discount", "noise"):
        np.testing.assert_array_equal(getattr(mirrored, name), getattr(plain, name))


def test_observations_without_a_scan_are_not_mirrored():
    replay = Replay(TransitionLayout(scan=0, rest=1, action=1), 50)
    replay.add(training.episode(replay.layout, 0, 5))
    mirror = BATCH.model_copy(update={"mirror": True})
    plain, mirrored = (
        draw_batch(replay, np.random.default_rng(0), options, torch.device("cpu"))
        for options in (BATCH, mirror)
    )
    np.testing.assert_array_equal(mirrored.observation, plain.observation)


@pytest.mark.parametrize("which", [0, 1, 2], ids=["an observation", "an action", "a reward"])
def test_numbers_that_are_not_finite_are_refused(which):
    arrays = [np.zeros((3, SMALL.size)), np.zeros((2, SMALL.action)), np.zeros(2)]
    arrays[which].flat[1] = np.nan
    with pytest.raises(ApplrError, match=("an observation", "an action", "a reward")[which]):
        Trajectory.of(SMALL, *arrays, False)


def test_a_replay_buffer_larger_than_memory_is_refused(monkeypatch):
    pages = {"SC_PAGE_SIZE": 4096, "SC_PHYS_PAGES": 2**20}  # 4 GiB
    monkeypatch.setattr("training.train.replay.buffer.os.sysconf", pages.__getitem__)
    with pytest.raises(
        ValueError,
        match=r"a replay buffer of 100000000 rows takes 79\.3 GB, this machine has 4\.3 GB: give",
    ):
        Replay(TransitionLayout(), 10**8)
