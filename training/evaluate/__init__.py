"""Evaluation of methods in worlds: trials, their runner and table, scores, comparisons, reports."""
