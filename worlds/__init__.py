"""Worlds: reading, generating, measuring and drawing the courses that robots drive."""
# Imports applr_ros1.common alone.

from .loading import Worlds, load, scaled, specs
from .world import Course, Mover, World, WorldError

__all__ = ["Course", "Mover", "World", "WorldError", "Worlds", "load", "scaled", "specs"]
