"""Processes that drive episodes and trials: a local pool and Ray behind one interface."""
