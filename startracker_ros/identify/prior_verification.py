"""
Whether recognised stars stand where a predicted attitude has them, and what chance would do.

The statistical model. Were the prediction wrong, or the stars false, the n observed stars
would be spread over the image by chance. Then pairs of an observed star and a predicted
place that agree within the uncertainty of the prediction number, on average, the sum of
the areas of their gates over the area of the image. One such pair leaves little of that
uncertainty but a turn about the star; each of the other n - 1 stars falls into one of the
gates that are left with a probability p, their areas over that of the image, and m - 1 of
them or more do so with the probability of a binomial tail. The product is the false-alarm
probability, as in chance.py but with the area that the prediction leaves to search
instead of the whole sky.

All places are x / z, y / z in the sensor frame. The state is the error of the prediction,
small: a rotation vector about sensor axes in rad and the relative error of the focal length.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class PriorMatch:
    """
    Observed stars at predicted places.

    row (N,) is the predicted star of each observed one, -1 for none; focal_ratio the fitted
    focal length over that of the camera; chance the false-alarm probability;
    contradicted is True when other recognised stars make another answer as believable.
    """

    row: np.ndarray
    focal_ratio: float
    chance: float
    contradicted: bool


@dataclass(frozen=True)
class _Gates:
    """
    How N observed stars and M predicted places agree; of one state, or of K side by side.

    square (..., N, M) is the squared distance in sigmas; area (..., N) the summed areas of the
    gates of each observed star in rad^2; change (..., 4) and covariance (..., 4, 4) the state
    they hold for.
    """

    square: np.ndarray
    area: np.ndarray
    change: np.ndarray
    covariance: np.ndarray

    def __getitem__(self, k: int) -> '_Gates':
        return _Gates(self.square[k], self.area[k], self.change[k], self.covariance[k])


def partial_derivatives(place: np.ndarray) -> np.ndarray:
    """Return how places (M, 2) move with the state, (M, 2, 4)."""
    x, y = place.T
    # v_sensor = R(q)^T v: a turn of the sensor by d moves a star by -d x v_sensor.
    return np.stack([np.stack([x * y, -1 - x * x, y, x], -1),
                     np.stack([1 + y * y, -x * y, -x, y], -1)], -2)


class PriorVerifier:
    """One frame against one prediction."""

    # Recognised stars, the brightest, whose places are tried as the true ones.
    _TRIALS = 20

    def __init__(self, observed: np.ndarray, sigma_rad: np.ndarray, predicted: np.ndarray,
                 inside: np.ndarray, covariance: np.ndarray, tolerance_sigmas: float,
                 area: float) -> None:
        """
        Take observed (N, 2) with errors sigma_rad (N,) per axis and predicted (M, 2) places.

        inside (M,) bool are the places in the image: on average as many gates reach into it from
        beyond its edge as out of it. covariance (4, 4) is that of the state, area that
        of the image in rad^2.
        """
        self._observed = observed
        self._variance = sigma_rad ** 2
        self._predicted = predicted
        self._inside = inside
        self._partial = partial_derivatives(predicted)
        self._tolerance = tolerance_sigmas ** 2
        self._image_area = area
        self._prior = self._gates(np.zeros(4), covariance)

    def verify(self, votes: np.ndarray, doubtful: np.ndarray,
               believed: float) -> PriorMatch | None:
        """
        Return the answer that most stars support; None when no vote agrees with the prior.

        votes (N,) is the recognised row of each observed star, -1 for none; doubtful (M,)
        bool are places that may not stand for their star; a chance up to believed counts.
        """
        voter = np.flatnonzero(votes >= 0)
        voter = voter[self._prior.square[voter, votes[voter]] <= self._tolerance][:self._TRIALS]
        if not len(voter):
            return None
        trials = self._after(voter[:, None], votes[voter][:, None])
        matches = self._pair_up(trials)
        best = max(range(len(voter)), key=lambda k: self._support(matches[k], trials[k]))
        gates = trials[best]
        for _ in range(2):
            row = self._pair_up(gates)
            known = np.flatnonzero(row >= 0)
            gates = self._after(known, row[known])
        # Two stars that are the same leave no room for two attitudes.
        contradicted = any(
            np.count_nonzero((match == row) & (row >= 0)) < 2
            and self._chance(match, trials[k]) <= believed
            for k, match in enumerate(matches))
        row = self._alone(gates, doubtful)
        return PriorMatch(row, 1 + gates.change[3], self._chance(row, trials[best]), contradicted)

    def _gates(self, change: np.ndarray, covariance: np.ndarray) -> _Gates:
        spread = self._partial @ covariance[..., None, :, :] @ self._partial.transpose(0, 2, 1)
        xx, yy = (spread[..., None, :, axis, axis] + self._variance[:, None] for axis in (0, 1))
        xy = spread[..., None, :, 0, 1]
        determinant = xx * yy - xy * xy
        moved = self._predicted + (self._partial @ change[..., None, :, None])[..., 0]
        away = self._observed[:, None] - moved[..., None, :, :]
        dx, dy = away[..., 0], away[..., 1]
        square = (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / determinant
        area = np.pi * self._tolerance * np.sqrt(determinant[..., self._inside]).sum(-1)
        return _Gates(square, area, change, covariance)

    def _after(self, star: np.ndarray, row: np.ndarray) -> _Gates:
        """
        Return the gates once observed stars (..., K) are known to be predicted ones (..., K).

        A Kalman update of the state.
        """
        partial = self._partial[row].reshape(*row.shape[:-1], -1, 4)
        covariance = self._prior.covariance
        residual = (self._observed[star] - self._predicted[row]).reshape(*row.shape[:-1], -1, 1)
        variance = np.repeat(self._variance[star], 2, -1)
        innovation = partial @ covariance @ partial.swapaxes(-1, -2)
        innovation = innovation + np.eye(variance.shape[-1]) * variance[..., None]
        gain = np.linalg.solve(innovation, partial @ covariance).swapaxes(-1, -2)
        return self._gates((gain @ residual)[..., 0], covariance - gain @ partial @ covariance)

    def _pair_up(self, gates: _Gates) -> np.ndarray:
        """Return the row (..., N) of each star, nearest both ways, -1 when out of its gate."""
        nearest = gates.square.argmin(-1)
        distance = np.take_along_axis(gates.square, nearest[..., None], -1)[..., 0]
        nearest_star = np.take_along_axis(gates.square.argmin(-2), nearest, -1)
        good = (nearest_star == np.arange(nearest.shape[-1])) & (distance <= self._tolerance)
        return np.where(good, nearest, -1)

    def _alone(self, gates: _Gates, doubtful: np.ndarray) -> np.ndarray:
        """Return the pairs that no other star or place near them can dispute."""
        row = self._pair_up(gates)
        # Twice the gate: noise takes neither of two such places for the other.
        disputed = (gates.square <= 4 * self._tolerance).sum(1) > 1
        crowd = (gates.square <= self._tolerance).sum(0) > 1
        return np.where(disputed | crowd[row] | doubtful[row], -1, row)

    def _support(self, row: np.ndarray, gates: _Gates) -> tuple[int, float]:
        """Return how many stars a trial explains, and for equal numbers how well."""
        known = np.flatnonzero(row >= 0)
        return len(known), -float(gates.square[known, row[known]].sum())

    def _chance(self, row: np.ndarray, gates: _Gates) -> float:
        """Return the false-alarm probability of an answer that began with these gates."""
        # Here, as only who predicts the attitude waits for it.
        from scipy.special import bdtrc
        others = np.count_nonzero(row >= 0) - 1
        if others < 1:
            return 1.0
        pairs = self._prior.area.sum() / self._image_area
        by_chance = min(1.0, gates.area.mean() / self._image_area)
        return float(min(1.0, pairs * bdtrc(others - 1, len(row) - 1, by_chance)))
