"""Helpers shared by several packages: angles, scans, files, errors, kernels, progress."""
# Imports no other package of this repository.
