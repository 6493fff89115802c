"""The rules of a trial: which course it has and what ends it. Training and evaluation drive under them."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

from worlds import World, barn


class Protocol(NamedTuple):
    """Rules of a trial. end_on_collision: a collision ends it."""

    end_on_collision: bool
    sentence: str


PAPER, CHALLENGE, DRAWN = "paper", "barn-challenge", "drawn"
PROTOCOLS = {
    PAPER: Protocol(
        False,
        "The paper's course: from 1 m before the reference path to y = 10 (5.925 m), goal 5 m beyond its "
        "end; a contact does not end the trial; 100 s.",
    ),
    CHALLENGE: Protocol(
        True,
        "The BARN Challenge's course: start (-2.25, 3), goal 10 m ahead, reached within 1 m; among moving obstacles "
        "start (11, 0), goal 20 m ahead; other worlds keep their course; a collision ends the trial; 100 s.",
    ),
}


def under(protocol: str, world: World) -> World:
    """The world with the protocol's course.

    A world of moving obstacles has the BARN Challenge's course for it under both, one that is none of BARN's its own.
    """
    if protocol == PAPER or not barn.fill_of(world.cylinders)[[0, -1]].all():
        return world
    return dataclasses.replace(world, course=barn.challenge_course(world.course.path))
