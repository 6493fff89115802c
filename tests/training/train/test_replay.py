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
from training.train.replay.buffer import ReplayBuffer

SMALL = TransitionLayout(scan=4, rest=2, action=2)
BATCH = LearnerOptions(batch_size=64, gamma=0.9)


def episode(length, number=0, terminated=False):
    """Return an episode of `length` transitions, drawn with the seed `number`."""
    return training.episode(SMALL, number, length, terminated=terminated)


def test_a_stored_scan_is_exact_to_half_a_step():
    layout = TransitionLayout()
    rng = np.random.default_rng(0)
    observations = rng.uniform(-1, 1, (5, layout.size)).astype(np.float32)

    stored_scans = layout.quantise(observations)
    restored = layout.restore(stored_scans, observations[:, layout.scan :])

    errors = np.abs(restored - observations)
    # The remainder is that of single precision.
    assert errors[:, :720].max() <= layout.step / 2 + 1e-6
    assert np.array_equal(restored[:, 720:], observations[:, 720:])

    # A value beyond the range is clipped, not wrapped.
    edges = np.zeros((1, layout.size), np.float32)
    edges[0, :3] = -1, 1, 5
    assert layout.quantise(edges)[0, :3].tolist() == [0, 255, 255]


@examples(60)
@given(
    st.lists(st.tuples(st.integers(1, 9), st.booleans()), min_size=1, max_size=12),
    st.integers(12, 40),
)
def test_samples_are_the_episodes_own_transitions(lengths, capacity):
    """Samples are compared with a list of episodes. The ring is overwritten several times."""
    # Given: episodes in a buffer, and where each of their observations is
    gamma = 0.9
    replay = ReplayBuffer(SMALL, capacity)
    origin_of = {}
    transition_count = 0
    for number, (length, terminated) in enumerate(lengths):
        trajectory = episode(length, number, terminated)
        replay.add(trajectory)
        transition_count += length
        for step in range(length):
            # The random numbers beside the scan tell an observation from all others.
            origin_of[trajectory.rest[step].tobytes()] = (trajectory, step)
    assert replay.transitions == transition_count

    # When: transitions are drawn
    rows = replay.draw(np.random.default_rng(0), 200)
    following_rows, discounts = replay.following(rows, gamma)

    # Then: each is the transition of its episode
    for row, discount, following in zip(rows, discounts, following_rows):
        trajectory, step = origin_of[replay.rest[row].tobytes()]
        # Only a real end has no future; a time limit or a cut has one.
        is_terminal = trajectory.terminated and step + 1 == len(trajectory)
        assert discount == np.float32(0.0 if is_terminal else gamma)

        assert replay.reward[row] == trajectory.reward[step]
        assert np.array_equal(replay.scan[row], trajectory.scan[step])
        assert np.array_equal(replay.action[row], trajectory.action[step])
        assert np.array_equal(replay.rest[following], trajectory.rest[step + 1])
        assert np.array_equal(replay.scan[following], trajectory.scan[step + 1])


def test_every_transition_is_drawn_equally_often():
    replay = ReplayBuffer(SMALL, 100)
    for number, length in enumerate((1, 2, 10)):
        replay.add(episode(length, number))

    rows = replay.draw(np.random.default_rng(0), 130_000)

    # Each of the 13 transitions is drawn 10,000 times, with a standard deviation of 96. The rows
    # with the last observations of the three episodes begin no transition.
    counts = np.bincount(rows, minlength=16)
    assert np.count_nonzero(counts) == 13
    assert counts[counts > 0].min() > 9_600
    assert counts.max() < 10_400


def test_a_batch_has_the_transitions_of_its_rows():
    replay = ReplayBuffer(SMALL, 50)
    trajectory = episode(5, terminated=True)
    replay.add(trajectory)

    batch = draw_batch(replay, np.random.default_rng(0), BATCH, torch.device("cpu"))

    observations = SMALL.restore(trajectory.scan, trajectory.rest)
    for row in range(64):
        # The step of the episode whose observation this is
        differences = np.abs(observations - batch.observation[row].numpy())
        step = int(np.argmin(differences.sum(1)))
        np.testing.assert_allclose(batch.observation[row], observations[step], atol=1e-6)
        np.testing.assert_allclose(batch.next_observation[row], observations[step + 1], atol=1e-6)
        assert float(batch.reward[row]) == trajectory.reward[step]
        discount = 0.9
        if step == 4:  # The episode ends with its fifth transition.
            discount = 0.0
        assert float(batch.discount[row]) == pytest.approx(discount)


def batches(replay):
    """Return a batch as it is, and the same batch with a mirrored half."""
    mirroring = BATCH.model_copy(update={"mirror": True})
    cpu = torch.device("cpu")
    plain = draw_batch(replay, np.random.default_rng(0), BATCH, cpu)
    mirrored = draw_batch(replay, np.random.default_rng(0), mirroring, cpu)
    return plain, mirrored


def test_mirror_exchanges_left_and_right_in_half_of_a_batch():
    replay = ReplayBuffer(SMALL, 50)
    replay.add(episode(5, terminated=True))
    plain, mirrored = batches(replay)
    scan = slice(0, SMALL.scan)
    goal_angle = SMALL.scan  # the entry that changes its sign
    parameters = slice(SMALL.scan + 1, None)
    for field_name in ("observation", "next_observation"):
        image = getattr(mirrored, field_name).numpy()
        original = getattr(plain, field_name).numpy()
        # The first 32 of the 64 rows are mirrored.
        np.testing.assert_array_equal(image[:32, scan], original[:32, scan][:, ::-1])
        np.testing.assert_array_equal(image[:32, goal_angle], -original[:32, goal_angle])
        np.testing.assert_array_equal(image[:32, parameters], original[:32, parameters])
        np.testing.assert_array_equal(image[32:], original[32:])
    for field_name in ("action", "reward", "discount", "noise"):
        np.testing.assert_array_equal(getattr(mirrored, field_name), getattr(plain, field_name))


def test_observations_without_a_scan_are_not_mirrored():
    replay = ReplayBuffer(TransitionLayout(scan=0, rest=1, action=1), 50)
    replay.add(training.episode(replay.layout, 0, 5))
    plain, mirrored = batches(replay)
    np.testing.assert_array_equal(mirrored.observation, plain.observation)


@pytest.mark.parametrize("name", ["an observation", "an action", "a reward"])
def test_numbers_that_are_not_finite_are_refused(name):
    arrays = {
        "an observation": np.zeros((3, SMALL.size)),
        "an action": np.zeros((2, SMALL.action)),
        "a reward": np.zeros(2),
    }
    arrays[name].flat[1] = np.nan
    with pytest.raises(ApplrError, match=name):
        Trajectory.of(SMALL, *arrays.values(), terminated=False)


def test_a_replay_buffer_larger_than_memory_is_refused(monkeypatch):
    # A machine of 4 GiB
    memory_pages = {
        "SC_PAGE_SIZE": 4096,
        "SC_PHYS_PAGES": 2**20,
    }
    monkeypatch.setattr("training.train.replay.buffer.os.sysconf", memory_pages.__getitem__)
    line = r"a replay buffer of 100000000 rows takes 79\.3 GB, this machine has 4\.3 GB: give"
    with pytest.raises(ValueError, match=line):
        ReplayBuffer(TransitionLayout(), 10**8)
