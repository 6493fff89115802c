"""Worlds: reading, generating, measuring and drawing the courses that robots drive."""

from .loading import Worlds, load, load_all, scaled, specs
from .world import Course, Mover, World, WorldError

__all__ = ["Course", "Mover", "World", "WorldError", "Worlds", "load", "load_all", "scaled", "specs"]
