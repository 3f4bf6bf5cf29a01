"""Kernels that look whether what came is what it should be."""

from __future__ import annotations

from numba import njit


@njit(cache=True, nogil=True)
def all_within(values, most):
    """Is none of values (N, K), float32 or float64, beyond +-most? NaN is."""
    wrong = 0
    for i in range(len(values)):
        for k in range(values.shape[1]):
            wrong += not abs(values[i, k]) <= most
    return wrong == 0


@njit(cache=True, nogil=True)
def goes_on(stamps_ns, longest_ns):
    """Does time rise from each of stamps_ns (M,) to the next, by at most longest_ns?"""
    wrong = 0
    for k in range(1, len(stamps_ns)):
        step_ns = stamps_ns[k] - stamps_ns[k - 1]
        wrong += step_ns <= 0 or step_ns > longest_ns
    return wrong == 0
