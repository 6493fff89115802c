"""Worlds that robots drive through: reading, generating, measuring and drawing them."""

from .loading import Worlds, listed_specs, load, scaled, specs
from .world import Course, Mover, World

__all__ = ["Course", "Mover", "World", "Worlds", "listed_specs", "load", "scaled", "specs"]
