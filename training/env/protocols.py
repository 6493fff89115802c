"""The rules of a trial: which course it has and what ends it. Training and evaluation drive under them."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

from worlds import World, WorldError, barn


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
        "start (11, 0), goal 20 m ahead; a collision ends the trial; 100 s.",
    ),
}


def under(protocol: str, world: World) -> World:
    """The world with the protocol's course. WorldError where it does not fit.

    A world of moving obstacles has the BARN Challenge's course for it under both.
    """
    if protocol == PAPER or (world.movers and not len(world.cylinders)):
        return world
    if not barn.fill_of(world.cylinders)[[0, -1]].all():
        raise WorldError(
            f"{world.name} is no BARN world: --protocol {protocol} needs one; give generated:N or a BARN file"
        )
    return dataclasses.replace(world, course=barn.challenge_course(world.course.path))
