"""Linear algebra on stacks of small covariance matrices: symmetrise, factorise with repair, solve."""

from __future__ import annotations

import numpy as np

from adcbf_cli.core.types import FloatArray, Notes

EIGENVALUE_FLOOR = 1e-10
"""Smallest eigenvalue that a repaired covariance keeps, relative to its largest one."""


def symmetrised(matrices: FloatArray) -> FloatArray:
    """(..., d, d) -> the same with each matrix the mean of itself and its transpose."""
    return 0.5 * (matrices + np.swapaxes(matrices, -1, -2))


def cholesky_with_repair(covariance: FloatArray, notes: Notes) -> tuple[FloatArray, FloatArray]:
    """Lower factors of n covariances (n, d, d), and the covariances that they belong to.

    Where a factorisation fails, that matrix's eigenvalues are raised to a floor relative to its
    largest one; each repair is counted as "repaired_factorisations".
    """
    try:
        return _cholesky(covariance), covariance
    except np.linalg.LinAlgError:
        pass  # numpy does not say which one failed: repair those whose eigenvalues are too small
    values, vectors = np.linalg.eigh(symmetrised(covariance))
    floor = EIGENVALUE_FLOOR * np.maximum(values[..., -1:], EIGENVALUE_FLOOR)
    broken = values[..., 0] < floor[..., 0]
    rebuilt = (vectors * np.maximum(values, floor)[..., None, :]) @ np.swapaxes(vectors, -1, -2)
    repaired = np.where(broken[..., None, None], symmetrised(rebuilt), covariance)
    notes.count("repaired_factorisations", int(np.count_nonzero(broken)))
    return _cholesky(repaired), repaired


def inverted(covariance: FloatArray) -> FloatArray:
    """The symmetric inverses of symmetric matrices (..., d, d)."""
    return symmetrised(np.asarray(np.linalg.inv(covariance), dtype=np.float64))


def quadratic_form(vectors: FloatArray, inverse: FloatArray) -> FloatArray:
    """v^T M v for stacks of vectors (..., k) and matrices (..., k, k) -> (...)."""
    product: FloatArray = np.einsum("...i,...ij,...j->...", vectors, inverse, vectors)
    return product


def turned(vectors: FloatArray, matrix: FloatArray) -> FloatArray:
    """M v for vectors (..., k) and matrices (..., j, k) -> (..., j)."""
    product: FloatArray = (matrix @ vectors[..., None])[..., 0]
    return product


def _cholesky(covariance: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
