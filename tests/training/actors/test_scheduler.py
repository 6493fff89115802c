"""Which tasks the workers are given."""

from training.actors.scheduler import TaskScheduler
from training.actors.tasks import Collect, Trial


def test_episodes_are_numbered_on_and_their_worlds_and_noise_follow_from_seed_and_transitions():
    made = TaskScheduler(3, 40, lambda transitions: 0.5 - transitions / 1000, 100, lambda actor: int(actor[-1]) * 10)
    assert made.next_task(1) is None  # before there is a policy
    made.ready = True
    first, second = made.next_task(1), made.next_task(1)
    assert (first.actor, first.episode, second.episode) == ("actor-1", 10, 11)
    assert (first.random, first.sigma) == (True, 0.5)
    made.transitions = 100
    third = made.next_task(0)
    assert (third.actor, third.episode, third.random, third.sigma) == ("actor-0", 0, False, 0.4)
    assert {made.next_task(0).world for _ in range(1000)} == set(range(40))
    again = TaskScheduler(3, 40, lambda transitions: 0.5, first_episode=lambda actor: 11)
    again.ready = True
    assert again.next_task(1).world == second.world


def test_evaluations_go_before_training():
    made = TaskScheduler(0, None, lambda transitions: 0.5)
    made.ready = True
    trials = [Trial("w", "dwa", i, i, "", "dwa", "ours") for i in range(2)]
    made.evaluate(trials)
    assert [made.next_task(i) for i in range(2)] == trials
    assert isinstance(made.next_task(2), Collect)
