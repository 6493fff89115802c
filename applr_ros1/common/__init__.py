"""Helpers shared by several packages: angles, scans, files, errors, kernels, progress."""
