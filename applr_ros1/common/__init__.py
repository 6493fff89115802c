"""Helpers that several packages share: angles, scans, files, errors, kernels, progress."""
# Imports none of them.
