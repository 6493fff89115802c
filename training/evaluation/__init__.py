"""Evaluation of methods in worlds: trials, their runner and table, scores, comparisons, reports."""
# Import rule: of this repository, modules here import only workers, env and common.
