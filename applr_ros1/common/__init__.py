"""Helpers shared by several packages: angles, scans, files, errors, kernels, progress."""
# Import rule: modules here import no other package of this repository.
