"""
The place nearest to two lines of sight, in one compiled call.

Gao and Cui 2016: the target lies at r = R_j + rho_j V_j, and crossing with V_j removes the
range: r x V_j = R_j x V_j. An error of position e_R and of direction e_V moves the line by
e_R + rho_j e_V, of which only the part across V_j counts.
"""

import math

import numpy as np
from startracker_ros.compiled import compiled

LOCATED, NOT_FINITE, NOT_UNIT, SAME_PLACE, PARALLEL, BEHIND_FIRST, BEHIND_SECOND, COVARIANCE = (
    range(8))
"""How solve() ended."""

_ROUNDS = 3
"""The second round knows the ranges, the third takes away the rounding of the second."""


@compiled
def solve(position: np.ndarray, direction: np.ndarray, covariance: np.ndarray, weighted: bool,
          min_baseline_m: float, min_sine: float, place: np.ndarray, spread: np.ndarray,
          measures: np.ndarray) -> int:
    """
    Return how it ended; fill place (3,), spread (3, 3) and measures (5,).

    position (2, 3) m, direction (2, 3) unit vectors, covariance (2, 6, 6) of position and
    direction. spread is the covariance of place in m^2; measures are both ranges in m, the
    sine of the angle between the lines, their smallest distance in m and its sigma.
    """
    for j in range(2):
        square = 0.0
        for i in range(3):
            square += direction[j, i] ** 2
            if not math.isfinite(position[j, i]):
                return NOT_FINITE
        if not math.isfinite(square):
            return NOT_FINITE
        if abs(square - 1) > 1e-6:
            return NOT_UNIT
    # All counts from the first observer: less is lost to rounding than from the Earth's centre.
    base_x = position[1, 0] - position[0, 0]
    base_y = position[1, 1] - position[0, 1]
    base_z = position[1, 2] - position[0, 2]
    if math.sqrt(base_x * base_x + base_y * base_y + base_z * base_z) < min_baseline_m:
        return SAME_PLACE
    normal = np.cross(direction[0], direction[1])
    sine = math.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    measures[2] = sine
    if sine < min_sine:
        return PARALLEL
    for i in range(3):
        normal[i] /= sine
    base = np.array([[0.0, 0.0, 0.0], [base_x, base_y, base_z]])
    local, weight, inverse = np.zeros(3), np.empty((2, 3, 3)), np.empty((3, 3))
    moved = np.zeros((2, 3, 3))
    for j in range(2):
        _across(direction[j], weight[j])
    _nearest(base, weight, local, inverse)
    _nearest(base, weight, local, inverse)
    for _ in range(_ROUNDS):
        for j in range(2):
            measures[j] = 0.0
            for i in range(3):
                measures[j] += direction[j, i] * (local[i] - base[j, i])
            _line_covariance(covariance[j], measures[j], moved[j])
        if measures[0] <= 0:
            return BEHIND_FIRST
        if measures[1] <= 0:
            return BEHIND_SECOND
        if not weighted:
            break
        for j in range(2):
            if not _information(direction[j], moved[j], weight[j]):
                return COVARIANCE
        if not _nearest(base, weight, local, inverse):
            return COVARIANCE
    # What moves the lines moves the place by inverse weight moved weight inverse.
    spread[:] = 0
    for j in range(2):
        gain = inverse @ weight[j]
        spread += gain @ moved[j] @ gain.T
    measures[3], variance = 0.0, 0.0
    for i in range(3):
        measures[3] += normal[i] * base[1, i]
        place[i] = position[0, i] + local[i]
        for k in range(3):
            variance += normal[i] * (moved[0, i, k] + moved[1, i, k]) * normal[k]
    measures[3] = abs(measures[3])
    measures[4] = math.sqrt(max(variance, 0.0))
    for i in range(3):
        if not (spread[i, i] >= 0 and math.isfinite(place[i])):
            return COVARIANCE
    return LOCATED


@compiled
def solve_all(position: np.ndarray, direction: np.ndarray, covariance: np.ndarray, weighted: bool,
              min_baseline_m: float, min_sine: float
              ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return solve() of positions (N, 2, 3), directions (N, 2, 3), covariances (N, 2, 6, 6)."""
    count = len(position)
    ended = np.empty(count, np.int64)
    place, spread = np.full((count, 3), np.nan), np.full((count, 3, 3), np.nan)
    measures = np.full((count, 5), np.nan)
    for n in range(count):
        ended[n] = solve(position[n], direction[n], covariance[n], weighted, min_baseline_m,
                         min_sine, place[n], spread[n], measures[n])
    return ended, place, spread, measures


@compiled
def _across(direction: np.ndarray, weight: np.ndarray) -> None:
    """Fill weight (3, 3) with the projection across a direction."""
    for i in range(3):
        for k in range(3):
            weight[i, k] = (i == k) - direction[i] * direction[k]


@compiled
def _line_covariance(covariance: np.ndarray, range_m: float, moved: np.ndarray) -> None:
    """Fill moved (3, 3) with the covariance of e_R + rho e_V."""
    for i in range(3):
        for k in range(3):
            moved[i, k] = (covariance[i, k] + range_m * (covariance[i, 3 + k]
                                                         + covariance[3 + i, k])
                           + range_m * range_m * covariance[3 + i, 3 + k])


@compiled
def _information(direction: np.ndarray, moved: np.ndarray, weight: np.ndarray) -> bool:
    """Fill weight (3, 3) with T' (T moved T')^-1 T, T (2, 3) across the direction."""
    # The axis that lies most across is the start of T.
    least = 0
    for i in range(1, 3):
        if abs(direction[i]) < abs(direction[least]):
            least = i
    axis = np.zeros(3)
    axis[least] = 1.0
    first = np.cross(direction, axis)
    first /= math.sqrt(first[0] ** 2 + first[1] ** 2 + first[2] ** 2)
    second = np.cross(direction, first)
    uu = uv = vv = 0.0
    for i in range(3):
        for k in range(3):
            uu += first[i] * moved[i, k] * first[k]
            uv += first[i] * moved[i, k] * second[k]
            vv += second[i] * moved[i, k] * second[k]
    determinant = uu * vv - uv * uv
    if not (uu > 0 and determinant > 0):
        return False
    for i in range(3):
        for k in range(3):
            weight[i, k] = (vv * first[i] * first[k] + uu * second[i] * second[k]
                            - uv * (first[i] * second[k] + second[i] * first[k])) / determinant
    return True


@compiled
def _nearest(base: np.ndarray, weight: np.ndarray, local: np.ndarray, inverse: np.ndarray) -> bool:
    """
    Move local (3,) to where the weighted distances from both lines are least.

    Fill inverse (3, 3) with that of the normal matrix; return whether there is one.
    """
    normal = weight[0] + weight[1]
    pull = weight[0] @ (base[0] - local) + weight[1] @ (base[1] - local)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for m in range(3):
            n, o = (m + 1) % 3, (m + 2) % 3
            inverse[m, i] = normal[j, n] * normal[k, o] - normal[j, o] * normal[k, n]
    determinant = (normal[0, 0] * inverse[0, 0] + normal[0, 1] * inverse[1, 0]
                   + normal[0, 2] * inverse[2, 0])
    if not determinant > 0:
        return False
    inverse /= determinant
    for i in range(3):
        local[i] += inverse[i, 0] * pull[0] + inverse[i, 1] * pull[1] + inverse[i, 2] * pull[2]
    return True
