"""Worlds that robots drive through: reading, generating, measuring and drawing them."""

from .loading import Worlds, load, scaled, specs
from .world import Course, Mover, World

__all__ = ["Course", "Mover", "World", "Worlds", "load", "scaled", "specs"]
