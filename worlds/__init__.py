"""Worlds: reading, generating, measuring and drawing the courses that robots drive."""

import applr_ros1  # noqa: F401 - it makes Ctrl-C one line while the rest is imported

from .loading import Worlds, load, load_all, specs
from .scaling import scaled
from .world import Course, Mover, World, WorldError

__all__ = ["Course", "Mover", "World", "WorldError", "Worlds", "load", "load_all", "scaled", "specs"]
