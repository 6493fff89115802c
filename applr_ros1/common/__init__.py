"""Helpers shared by several packages: angles, scans, files, errors, kernels, progress."""
# Imports none of those packages.
