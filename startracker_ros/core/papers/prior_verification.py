# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Verification of recognised stars against a predicted attitude.

All stars are points x / z, y / z of the tangent plane in the sensor frame. The state is the
error of the prediction, small: a rotation vector about sensor axes in rad and the relative
error of the focal length. With its covariance P, the partial derivatives H_j of predicted star j
and the variance sigma_i^2 of observed star i, the innovation is y_ij = z_i - z_j, its covariance

    S_ij = H_j P H_j^T + sigma_i^2 I,

and the two may be the same star where y^T S^-1 y <= n^2, n = tolerance_sigmas. The gate has the
area pi n^2 sqrt(det S).

False-alarm probability. Were the prediction wrong, or the stars false, the n observed stars
would be anywhere in the image. The expected number E of pairs of an observed and a predicted
star within their gate is the sum of all gate areas over the area A of the image. One such pair,
as a measurement, leaves little of P but the turn about that star. Each of the other n - 1 stars
falls into one of the gates that remain with the probability p, their total area over A, and
m - 1 or more of them do so with the binomial tail:

    P_FA = E sum_{k = m - 1}^{n - 1} C(n - 1, k) p^k (1 - p)^(n - 1 - k),

as in false_alarm.py but with the area that the prediction leaves instead of the whole sky.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class PriorMatch:
    """
    Observed stars associated with predicted ones.

    row (N,) is the predicted star of each observed one, -1 for none; focal_ratio the fitted
    focal length over that of the camera; contradicted is True when other recognised stars
    give another association of a sufficient false-alarm probability.
    """

    row: np.ndarray
    focal_ratio: float
    false_alarm: float
    contradicted: bool


@dataclass(frozen=True)
class _Gates:
    """
    Gates of N observed stars about M predicted ones; of one state, or of K side by side.

    square (..., N, M) is y^T S^-1 y; area (..., N) the summed areas of the gates of each
    observed star in rad^2; state (..., 4) and covariance (..., 4, 4) they hold for.
    """

    square: np.ndarray
    area: np.ndarray
    state: np.ndarray
    covariance: np.ndarray

    def __getitem__(self, k: int) -> '_Gates':
        return _Gates(self.square[k], self.area[k], self.state[k], self.covariance[k])


def partial_derivatives(tangent: np.ndarray) -> np.ndarray:
    """Return H (M, 2, 4) of predicted stars (M, 2) by the state."""
    x, y = tangent.T
    # v_sensor = R(q)^T v: a turn of the sensor by d moves a star by -d x v_sensor.
    return np.stack([np.stack([x * y, -1 - x * x, y, x], -1),
                     np.stack([1 + y * y, -x * y, -x, y], -1)], -2)


class PriorVerifier:
    """One frame against one prediction."""

    # Recognised stars, the brightest, each of which is tried as the first true one.
    _HYPOTHESES = 20

    def __init__(self, observed: np.ndarray, sigma_rad: np.ndarray, predicted: np.ndarray,
                 inside: np.ndarray, covariance: np.ndarray, tolerance_sigmas: float,
                 area: float) -> None:
        """
        Prepare for observed stars (N, 2) of sigma_rad (N,) and predicted ones (M, 2).

        inside (M,) bool are the predicted stars in the image; only their gates are counted: on
        average as many gates reach into the image from beyond its edge as out of it.
        covariance (4, 4) is P, area A in rad^2.
        """
        self._observed = observed
        self._variance = sigma_rad ** 2
        self._predicted = predicted
        self._inside = inside
        self._partial = partial_derivatives(predicted)
        self._gate = tolerance_sigmas ** 2
        self._image_area = area
        self._prior = self._gates(np.zeros(4), covariance)

    def verify(self, recognised: np.ndarray, doubtful: np.ndarray,
               false_alarm_max: float) -> PriorMatch | None:
        """
        Return the best supported association; None when no recognised star is in its gate.

        recognised (N,) is the row of the predicted star that each observed one was recognised
        as, -1 for none; doubtful (M,) bool are predicted stars whose centroids may be disturbed.
        """
        star = np.flatnonzero(recognised >= 0)
        star = star[self._prior.square[star, recognised[star]] <= self._gate][:self._HYPOTHESES]
        if not len(star):
            return None
        hypotheses = self._updated(star[:, None], recognised[star][:, None])
        rows = self._associate(hypotheses)
        best = max(range(len(star)), key=lambda k: self._support(rows[k], hypotheses[k]))
        gates = hypotheses[best]
        for _ in range(2):
            row = self._associate(gates)
            known = np.flatnonzero(row >= 0)
            gates = self._updated(known, row[known])
        # Two shared stars allow one attitude only.
        contradicted = any(
            np.count_nonzero((other == row) & (row >= 0)) < 2
            and self._false_alarm(other, hypotheses[k]) <= false_alarm_max
            for k, other in enumerate(rows))
        row = self._undisputed(gates, doubtful)
        return PriorMatch(row, 1 + gates.state[3], self._false_alarm(row, hypotheses[best]),
                          contradicted)

    def _gates(self, state: np.ndarray, covariance: np.ndarray) -> _Gates:
        predicted = self._partial @ covariance[..., None, :, :] @ self._partial.transpose(0, 2, 1)
        xx, yy = (predicted[..., None, :, axis, axis] + self._variance[:, None]
                  for axis in (0, 1))
        xy = predicted[..., None, :, 0, 1]
        determinant = xx * yy - xy * xy
        moved = self._predicted + (self._partial @ state[..., None, :, None])[..., 0]
        innovation = self._observed[:, None] - moved[..., None, :, :]
        dx, dy = innovation[..., 0], innovation[..., 1]
        square = (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / determinant
        area = np.pi * self._gate * np.sqrt(determinant[..., self._inside]).sum(-1)
        return _Gates(square, area, state, covariance)

    def _updated(self, star: np.ndarray, row: np.ndarray) -> _Gates:
        """Return the gates after a Kalman update: observed stars (..., K) are rows (..., K)."""
        partial = self._partial[row].reshape(*row.shape[:-1], -1, 4)
        covariance = self._prior.covariance
        innovation = (self._observed[star] - self._predicted[row]).reshape(
            *row.shape[:-1], -1, 1)
        variance = np.repeat(self._variance[star], 2, -1)
        total = partial @ covariance @ partial.swapaxes(-1, -2)
        total = total + np.eye(variance.shape[-1]) * variance[..., None]
        gain = np.linalg.solve(total, partial @ covariance).swapaxes(-1, -2)
        return self._gates((gain @ innovation)[..., 0], covariance - gain @ partial @ covariance)

    def _associate(self, gates: _Gates) -> np.ndarray:
        """Return the row (..., N) of each star, nearest both ways, -1 when out of its gate."""
        nearest = gates.square.argmin(-1)
        square = np.take_along_axis(gates.square, nearest[..., None], -1)[..., 0]
        nearest_star = np.take_along_axis(gates.square.argmin(-2), nearest, -1)
        good = (nearest_star == np.arange(nearest.shape[-1])) & (square <= self._gate)
        return np.where(good, nearest, -1)

    def _undisputed(self, gates: _Gates, doubtful: np.ndarray) -> np.ndarray:
        """Return the association without stars that have a second possible partner."""
        row = self._associate(gates)
        # Twice the gate: noise does not confuse two predicted stars so far apart.
        disputed = (gates.square <= 4 * self._gate).sum(1) > 1
        shared = (gates.square <= self._gate).sum(0) > 1
        return np.where(disputed | shared[row] | doubtful[row], -1, row)

    def _support(self, row: np.ndarray, gates: _Gates) -> tuple[int, float]:
        """Return the number of associated stars and minus the sum of their y^T S^-1 y."""
        known = np.flatnonzero(row >= 0)
        return len(known), -float(gates.square[known, row[known]].sum())

    def _false_alarm(self, row: np.ndarray, gates: _Gates) -> float:
        """Return the false-alarm probability of an association that began with these gates."""
        # Imported here: a slow import that only a predicted attitude needs.
        from scipy.special import bdtrc
        others = np.count_nonzero(row >= 0) - 1
        if others < 1:
            return 1.0
        pairs = self._prior.area.sum() / self._image_area
        p = min(1.0, gates.area.mean() / self._image_area)
        return float(min(1.0, pairs * bdtrc(others - 1, len(row) - 1, p)))
