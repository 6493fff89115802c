"""Comparison of times that are sums of periods."""

TIME_TOLERANCE_S = 1e-6  # largest rounding error of such a sum [s]
