# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Compiled fits of residuals against NumPy's decomposition."""

import numpy as np
from startracker_ros.core.integrity.consistency import fit_rows, lens_sums

AXIS, HEIGHT, STEPS = np.array([500.0, 510.0]), 1024, 12


def scene(seed=1, stars=14):
    rng = np.random.default_rng(seed)
    half = rng.normal(0, 0.1, (stars, 2, 2))
    error = half @ half.transpose(0, 2, 1) + 0.01 * np.eye(2)
    return (rng.uniform(0, 1023, (stars, 2)), rng.normal(0, 0.2, (stars, 2)), error,
            rng.normal(0, 5000, (stars, 2, 3)), rng.normal(0, 50, (stars, 2)))


def test_rows_are_fitted_as_by_a_qr_decomposition():
    uv, residual, error, flow, velocity = scene()
    fit = fit_rows(uv, residual, error, flow, velocity, AXIS, HEIGHT, STEPS)
    rows = (uv[:, 1] - (HEIGHT - 1) / 2) / HEIGHT
    patterns = np.concatenate([rows[None], (rows > fit.edges[:, None]) - 0.5])
    away = (uv - AXIS) / HEIGHT
    radial = away * np.sum(away ** 2, axis=1, keepdims=True)
    whiten = np.linalg.inv(np.linalg.cholesky(error))

    def columns(vectors):
        return np.einsum('kij,kj...->ki...', whiten, vectors).reshape(2 * len(uv), -1)
    basis = np.linalg.qr(columns(np.concatenate(
        [flow, away[..., None], radial[..., None]], axis=-1)))[0]
    r, c = columns(residual)[:, 0], columns(velocity[..., None] * patterns.T[:, None])
    r, c = r - basis @ (basis.T @ r), c - basis @ (basis.T @ c)
    np.testing.assert_allclose(fit.product, c.T @ r, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(fit.energy, (c * c).sum(axis=0), rtol=1e-9)
    np.testing.assert_allclose(fit.chi2, r @ r, rtol=1e-10)
    assert np.isin(fit.edges, np.sort(rows)[3:-3]).all()


def test_the_rotation_is_taken_out_of_residuals_and_distances():
    uv, residual, error, flow, _ = scene(2)
    sums = lens_sums(uv, residual, error, flow, AXIS)
    variance = np.trace(error, axis1=1, axis2=2) / 2
    V = np.repeat(variance, 2)
    F = flow.reshape(-1, 3)
    A = np.eye(len(V)) - F @ np.linalg.solve((F.T / V) @ F, F.T / V)
    np.testing.assert_allclose(sums.residual.ravel(), A @ residual.ravel(), atol=1e-12)
    np.testing.assert_allclose(sums.away.ravel(), A @ (uv - AXIS).ravel(), atol=1e-9)
    np.testing.assert_allclose(
        sums.left, np.diag(A @ A.T).reshape(-1, 2).mean(axis=1), rtol=1e-10)
    away = A @ (uv - AXIS).ravel()
    np.testing.assert_allclose(sums.square, (away / V) @ away, rtol=1e-10)


def test_dependent_columns_count_once():
    uv, residual, error, flow, velocity = scene(3)
    flow[..., 2] = 2 * flow[..., 0]
    fit = fit_rows(uv, residual, error, flow, velocity, AXIS, HEIGHT, STEPS)
    assert np.isfinite(fit.product).all() and fit.chi2 > 0
