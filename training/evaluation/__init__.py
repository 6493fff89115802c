"""Trials of methods in worlds: a trial, its runner, their table, comparison, score, report and pages."""
# Imports workers, env and common.
