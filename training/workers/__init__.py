"""Processes that drive episodes and trials: a local pool and Ray behind one interface."""
# Import rule: of this repository, modules here import only replay.
