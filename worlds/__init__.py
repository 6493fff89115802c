"""Worlds that robots drive through: reading, generating, measuring and drawing them."""
# Import rule: of this repository, modules here import only applr_ros1.common.

from .loading import Worlds, load, scaled, specs
from .world import Course, Mover, World

__all__ = ["Course", "Mover", "World", "Worlds", "load", "scaled", "specs"]
