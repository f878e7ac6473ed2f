# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The motion of the body: an interacting multiple model filter of attitude and rate, compiled.

The stars of a frame measure the attitude; how the body goes on is not known. Several Kalman
filters run side by side, one for each mode of motion, and are mixed as by Blom and Bar-Shalom
(IEEE Trans. Autom. Control 33, 1988). With the probability mu_i of mode i and the probability
p_ij of a change from i to j:

    c_j = sum p_ij mu_i,  mu_i|j = p_ij mu_i / c_j,  x0_j = sum mu_i|j x_i,
    P0_j = sum mu_i|j (P_i + (x_i - x0_j) (x_i - x0_j)^T),
    each is predicted and updated by the frame,  mu_j = c_j L_j / sum c_k L_k,

L_j the likelihood of the frame. p_ij is STAYS if the mode does not change, else by the share that
mode j had in the frames before: of a body that turns steadily none is left for jumps.

The error state of a mode is [turn, rate, acceleration, drift] about sensor axes and K constants
more that walk at random, as mounts of several heads on a body do: N = 12 + K. Modes:

    steady       constant rate, white acceleration
    torque       constant acceleration, white jerk
    swing        acceleration' = -w^2 (rate - r), white jerk; w of the whole body by least squares,
                 r its mean rate
    jump         as steady, with accelerations that no torque of the others gives

The process noise of torque and swing is in units of what one frame measures: they predict the next
frame to k sigma of its own attitude. What is smaller does not show, at any camera. That of steady
and jump is in units of the acceleration of the options.

What is published has the mean and the covariance of the mixture. A normal distribution of these
moments has no such tails as the mixture: with a mode of the probability p, whose mean is m away
and whose sigma is s, the sigma of an axis is at least (|m| + c s) / 5, c as of tail_sigmas().
"""

import math
from typing import NamedTuple

import numpy as np
from startracker_ros.core.attitude.attitude_state import AttitudeState
from startracker_ros.core.attitude.result import WRONG_SIGMAS
from startracker_ros.core.compiled import compiled
from startracker_ros.core.maths.compiled_rotation import (
    matrix_from_rotation_vector, rotation_between, turned)
from startracker_ros.core.maths.small_algebra import (
    determinant, inner, inverse, inverse_and_determinant, product, times)

STEADY, TORQUE, SWING, JUMP = 0, 1, 2, 3
KIND = np.array([STEADY, TORQUE, TORQUE, TORQUE, TORQUE, SWING, SWING, JUMP, JUMP])
SIZE = np.array([1.0, 0.02, 0.2, 2.0, 20.0, 0.1, 1.0, 100.0, 1000.0])
"""Of each mode: sigmas of a frame that its prediction is off by; of steady and jump the
acceleration in units of that of the options."""

SUDDEN = SIZE >= 20.0  # modes of motions that begin within a frame
SMOOTH = np.flatnonzero(SIZE < 2.0)
WIDE = [np.array([mode]) for mode in np.flatnonzero(KIND == JUMP)]
"""Modes tried one after the other where a frame is not as the mixture of all has it."""

STAYS = 0.95  # probability that a mode lasts to the next frame
NEGLIGIBLE = 1e-2  # share of a mode that is not mixed into it
LEAST_SHARE = np.full(len(KIND), 1e-4)  # of modes that were not seen for long
LEAST_NEXT = np.array([1e-4, 1e-4, 1e-4, 0.05, 0.02, 1e-4, 1e-4, 0.02, 0.02])
"""The same in the next frame: when a motion begins is not known before. What is predicted further
ahead is what the body has been seen to do."""

FIRST_FRAMES, MOST_FRAMES = 5.0, 200.0  # that the shares are the means of
FIRST_SHARE = np.array([1.0, 0.1, 0.1, 0.05, 0.01, 0.1, 0.05, 0.005, 0.005])
"""Shares before the first frame, not normalised: most bodies turn smoothly."""

NOISE_MEMORY = 0.95  # of the size of the noise of a frame
SWING_MEMORY = 0.93  # of the sums of the fit of w
FASTEST = -1.0  # 2 cos(w dt): three frames in a period
SIGNIFICANT_ENERGY = 200.0  # of a swing, over the variance of the noise; that of noise: 55
FIRST_ACCELERATION = np.radians(1.0)  # rad/s^2, 1 sigma, before the first frame
SEEN_UNEVENLY = 0.07
"""Of the amplitude of a vibration: what the fit of a star that it moves within the exposure is off
by, 1 sigma."""
MISSED, MISSED_AHEAD = 2e-5, 4e-5
"""
Probability that attitude and rate are beyond WRONG_SIGMAS by an improbable mode, now and at other
times: motions that may begin, which are hardly ever seen, would widen all that is predicted.
"""

MISSED_LIGHT = 1e-3
"""The same by a jump within an exposure: most frames have no jump."""

NO_CONSTANTS = np.empty(0)


class Motion(NamedTuple):
    """
    What is known of the motion at a time.

    quaternion (4,) is the mean attitude, q_icrf_from_sensor. Of the M modes: mean (M, N) of the
    error state [turn from the quaternion, rate, acceleration, drift of the gyro, constants] and
    covariance (M, N, N), weight (M,) the probabilities, share (M,) their means in the frames
    before, of a number of frames. noise (3,) rad^2 is the variance of the attitude that the stars
    of a frame measure, interval_s that of the frames, zero while unknown; swing (20,) is what is
    known of a swing.
    """

    stamp_ns: int
    quaternion: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray
    weight: np.ndarray
    share: np.ndarray
    noise: np.ndarray
    interval_s: float
    frames: float
    swing: np.ndarray


# Of the array swing: the attitude measured last, the turn from the one before, its change, the
# change before, NaN where not known; sums of a_k-1 (a_k + a_k-2) and of a_k-1^2 over the variance
# of a change, less what noise gives; w^2; the mean rate of the swing, with its weight.
LAST, TURN, CHANGE, OLDER = slice(0, 4), slice(4, 7), slice(7, 10), slice(10, 13)
PRODUCT, ENERGY, W2, WEIGHT, CENTRE = 13, 14, 15, 16, slice(17, 20)


def started(state: AttitudeState, noise: np.ndarray, interval_s: float,
            constants: np.ndarray = NO_CONSTANTS) -> Motion:
    """
    Return the motion of a state, each mode with its attitude and rate; noise is (3,).

    Of constants (K,) the covariance of the state is (9 + K, 9 + K).
    """
    count, size = len(KIND), 12 + len(constants)
    share = FIRST_SHARE / FIRST_SHARE.sum()
    mean, P = np.zeros((count, size)), np.zeros((count, size, size))
    mean[:, 3:6], mean[:, 9:12], mean[:, 12:] = state.rate, state.drift, constants
    seen = np.r_[0:6, 9:size]
    for mode in range(count):
        P[mode][np.ix_(seen, seen)] = state.covariance
        if KIND[mode] in (TORQUE, SWING):
            P[mode][6:9, 6:9] = np.eye(3) * FIRST_ACCELERATION ** 2
    swing = np.full(20, np.nan)
    swing[PRODUCT:] = 0.0
    return Motion(state.stamp_ns, state.quaternion, mean, P, share.copy(), share, noise,
                  interval_s, FIRST_FRAMES, swing)


def restarted(motion: Motion, state: AttitudeState) -> Motion:
    """Return a motion that goes on from a state, which is known without its modes."""
    mean, P = motion.mean.copy(), motion.covariance.copy()
    mean[:, :3], mean[:, 3:6], mean[:, 9:12] = 0.0, state.rate, state.drift
    mean[:, 12:] = motion.weight @ motion.mean[:, 12:]
    seen = np.r_[0:6, 9:mean.shape[1]]
    P[:, 6:9, seen] = 0.0
    P[:, seen, 6:9] = 0.0
    P[np.ix_(range(len(P)), seen, seen)] = state.covariance
    return motion._replace(stamp_ns=state.stamp_ns, quaternion=state.quaternion, mean=mean,
                           covariance=P, weight=motion.share)


def resumed(motion: Motion, known: Motion) -> Motion:
    """Return a motion that began anew, with what was known of how the body moves."""
    return motion._replace(
        weight=known.weight, share=known.share, noise=known.noise, interval_s=known.interval_s,
        frames=known.frames, swing=known.swing)


def interrupted(motion: Motion) -> Motion:
    """Return a motion whose next frame has no neighbour: its differences begin again."""
    swing = motion.swing.copy()
    swing[:PRODUCT] = np.nan
    return motion._replace(swing=swing)


def state_of(motion: Motion, modes: np.ndarray | None = None) -> AttitudeState:
    """Return attitude, rate and drift of the mixture, or of some modes of it."""
    return state_and_constants(motion, motion.weight if modes is None else weight_of(
        motion, modes))[0]


def weight_of(motion: Motion, modes: np.ndarray) -> np.ndarray:
    """Return the weights (M,) of some modes, zero for the others."""
    weight = np.zeros(len(KIND))
    weight[modes] = motion.weight[modes]
    return weight


def state_and_constants(motion: Motion, weight: np.ndarray) -> tuple[AttitudeState, np.ndarray]:
    """
    Return the mixture by weights (M,), not normalised, and its constants (K,).

    The covariance of the state (9 + K, 9 + K) has these as well.
    """
    *state, constants = _moments(motion, weight)
    return AttitudeState(motion.stamp_ns, *state), constants


@compiled
def mixture(weight: np.ndarray, mean: np.ndarray, covariance: np.ndarray
            ) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean (N,) and covariance (N, N) of a mixture of weights (M,), not normalised."""
    total, n = weight.sum(), mean.shape[1]
    middle, P = np.zeros(n), np.zeros((n, n))
    for k in range(len(weight)):
        if weight[k] > 0:
            for i in range(n):
                middle[i] += weight[k] / total * mean[k, i]
    for k in range(len(weight)):
        if weight[k] == 0:
            continue
        share = weight[k] / total
        for i in range(n):
            away = mean[k, i] - middle[i]
            for j in range(n):
                P[i, j] += share * (covariance[k, i, j] + away * (mean[k, j] - middle[j]))
    return middle, P


@compiled
def _moments(motion: Motion, weight: np.ndarray
             ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return quaternion, rate, drift, covariance (N - 3, N - 3), constants, by weights (M,)."""
    mean, P = mixture(weight, motion.mean, motion.covariance)
    n = len(P) - 3
    seen = np.empty((n, n))
    seen[:6, :6], seen[6:, 6:] = P[:6, :6], P[9:, 9:]
    seen[:6, 6:], seen[6:, :6] = P[:6, 9:], P[9:, :6]
    return (turned(motion.quaternion, mean[:3]), mean[3:6].copy(), mean[9:12].copy(), seen,
            mean[12:].copy())


@compiled
def mixed(motion: Motion, before: np.ndarray, acceleration: np.ndarray, least: np.ndarray
          ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return weight (M,), mean (M, N) and covariance (M, N, N) of the modes before a prediction.

    before (M,) are their weights, least (M,) their least shares. No mode but the first has more
    than the largest acceleration of the jumps. A mode of no weight has no numbers.
    """
    count, n = motion.mean.shape
    share = motion.share + least
    for j in range(count):
        # Without a frequency it is the torque of the same size.
        if KIND[j] == SWING and motion.swing[W2] == 0:
            share[j] = 0.0
        shown = SIZE[j] * math.sqrt(3 * motion.noise[0]) / motion.interval_s ** 2
        if j > 0 and KIND[j] != JUMP and shown > SIZE[-1] * acceleration.max():
            share[j] = 0.0
    share = share / share.sum()
    mean, P = np.empty((count, n)), np.empty((count, n, n))
    weight = np.empty(count)
    for j in range(count):
        to_j = before * ((1 - STAYS) * share[j])
        to_j[j] += before[j] * STAYS
        weight[j] = to_j.sum()
        if weight[j] == 0:
            mean[j], P[j] = motion.mean[j], motion.covariance[j]
            continue
        # What hardly any of a mode comes from would widen it all the same, in each frame.
        to_j = np.where(to_j < NEGLIGIBLE * to_j.sum(), 0.0, to_j)
        mean[j], P[j] = mixture(to_j, motion.mean, motion.covariance)
    return weight, mean, P


@compiled
def transition_and_noise(kind: int, size: float, tau_s: float, w2: float, noise: np.ndarray,
                         dt_s: float, acceleration: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return F (3, 3) and Q (3, 3, 3) of [turn, rate, acceleration], Q of each axis, in tau_s.

    F has the turn without that of the axes. White acceleration of density q: Q of turn and rate
    [t^3 / 3, t^2 / 2; ., t] q. White jerk:
    [t^5 / 20, t^4 / 8, t^3 / 6; ., t^3 / 3, t^2 / 2; ., ., t] q.
    """
    F, Q, t = np.eye(3), np.zeros((3, 3, 3)), abs(tau_s)
    F[0, 1] = tau_s
    if kind in (STEADY, JUMP):
        F[2, 2] = 0.0
        for axis in range(3):
            a2 = (size * acceleration[axis]) ** 2
            q = a2 * dt_s
            Q[axis, 0, 0] = q * t ** 3 / 3
            Q[axis, 0, 1] = Q[axis, 1, 0] = q * tau_s * t / 2
            Q[axis, 1, 1] = q * t
            if kind == JUMP:
                # It may go on at any of these accelerations.
                Q[axis, 2, 2] = a2
        return F, Q
    F[0, 2], F[1, 2] = tau_s * tau_s / 2, tau_s
    if kind == SWING and w2 > 0:
        w = math.sqrt(w2)
        sine, cosine = math.sin(w * tau_s), math.cos(w * tau_s)
        F[0, 1], F[0, 2] = sine / w, (1 - cosine) / w2
        F[1, 1], F[1, 2], F[2, 1], F[2, 2] = cosine, sine / w, -w * sine, cosine
    for axis in range(3):
        q = size * size * noise[axis] * 20 / dt_s ** 5
        Q[axis, 0, 0], Q[axis, 1, 1], Q[axis, 2, 2] = q * t ** 5 / 20, q * t ** 3 / 3, q * t
        Q[axis, 0, 1] = Q[axis, 1, 0] = q * t ** 3 * tau_s / 8
        Q[axis, 0, 2] = Q[axis, 2, 0] = q * t ** 3 / 6
        Q[axis, 1, 2] = Q[axis, 2, 1] = q * t * tau_s / 2
    return F, Q


@compiled
def _carry(P: np.ndarray, A: np.ndarray, F: np.ndarray) -> None:
    """Replace P (N, N) by Phi P Phi^T, with F as above and the turn A (3, 3) of the axes."""
    n = len(P)
    for k in range(n):
        x, y, z = P[0, k], P[1, k], P[2, k]
        for i in range(3):
            rate, more = P[3 + i, k], P[6 + i, k]
            P[i, k] = (A[i, 0] * x + A[i, 1] * y + A[i, 2] * z
                       + F[0, 1] * rate + F[0, 2] * more)
            P[3 + i, k] = F[1, 1] * rate + F[1, 2] * more
            P[6 + i, k] = F[2, 1] * rate + F[2, 2] * more
    for k in range(n):
        x, y, z = P[k, 0], P[k, 1], P[k, 2]
        for i in range(3):
            rate, more = P[k, 3 + i], P[k, 6 + i]
            P[k, i] = (A[i, 0] * x + A[i, 1] * y + A[i, 2] * z
                       + F[0, 1] * rate + F[0, 2] * more)
            P[k, 3 + i] = F[1, 1] * rate + F[1, 2] * more
            P[k, 6 + i] = F[2, 1] * rate + F[2, 2] * more


@compiled
def _add_noise(P: np.ndarray, Q: np.ndarray) -> None:
    """Add the Q of each axis to P (N, N)."""
    for axis in range(3):
        for i in range(3):
            for k in range(3):
                P[3 * i + axis, 3 * k + axis] += Q[axis, i, k]


@compiled
def turn_of(mean: np.ndarray, kind: int, tau_s: float, swing: np.ndarray) -> np.ndarray:
    """Return the turn (3,) of a body with the rate and acceleration of a mode, mean (12,)."""
    if kind in (STEADY, JUMP):
        return tau_s * mean[3:6]
    if kind == TORQUE or swing[W2] == 0:
        return tau_s * (mean[3:6] + tau_s / 2 * mean[6:9])
    w = math.sqrt(swing[W2])
    return (tau_s * swing[CENTRE] + math.sin(w * tau_s) / w * (mean[3:6] - swing[CENTRE])
            + (1 - math.cos(w * tau_s)) / swing[W2] * mean[6:9])


@compiled
def _carry_mean(x: np.ndarray, F: np.ndarray, kind: int, swing: np.ndarray) -> None:
    """Replace the error state (N,) of a mode by that after its transition, without the turn."""
    swings = kind == SWING and swing[W2] > 0
    for i in range(3):
        middle = swing[CENTRE][i] if swings else 0.0
        rate, more = x[3 + i] - middle, x[6 + i]
        x[i] = 0.0
        x[3 + i] = F[1, 1] * rate + F[1, 2] * more + middle
        x[6 + i] = F[2, 1] * rate + F[2, 2] * more


@compiled
def predicted(motion: Motion, to_ns: int, dt_s: np.ndarray, measured: np.ndarray,
              variance: np.ndarray, acceleration: np.ndarray, walk: np.ndarray) -> Motion:
    """
    Return the motion at a later time, each mode updated by rates of a gyro.

    Rates measured (K, 3) rad/s of variance (K,) about each axis, dt_s (K + 1,) after one another
    and up to the end. acceleration (3,) rad/s^2 is that of the options; walk (N - 9,) are the
    spectral densities of drift and constants.
    """
    weight, mean, covariance = mixed(
        motion, motion.weight, acceleration, LEAST_NEXT)
    count, swing = len(weight), motion.swing
    logs = np.zeros(count)
    attitude = np.empty((count, 4))
    for j in range(count):
        attitude[j] = motion.quaternion
        if weight[j] == 0:
            logs[j] = -np.inf
            continue
        x, P = mean[j], covariance[j]
        q = turned(motion.quaternion, x[:3])
        for k in range(len(dt_s)):
            turn = turn_of(x, KIND[j], dt_s[k], swing)
            F, Q = transition_and_noise(KIND[j], SIZE[j], dt_s[k], swing[W2], motion.noise,
                                        motion.interval_s, acceleration)
            _carry_mean(x, F, KIND[j], swing)
            _carry(P, matrix_from_rotation_vector(turn).T, F)
            _add_noise(P, Q)
            for i in range(len(walk)):
                P[9 + i, 9 + i] += walk[i] * dt_s[k]
            q = turned(q, turn)
            if k < len(measured):
                logs[j] += _correct_by_rate(x, P, measured[k], variance[k])
                q = turned(q, x[:3])
                x[:3] = 0.0
        attitude[j] = q
    weight = _by_logs(weight, logs)
    # About the attitude of the most probable mode.
    reference = attitude[np.argmax(weight)]
    for j in range(count):
        mean[j, :3] = rotation_between(reference, attitude[j])
    return _about_mean(Motion(to_ns, reference, mean, covariance, weight, motion.share,
                              motion.noise, motion.interval_s, motion.frames, motion.swing))


@compiled
def _correct_by_rate(x: np.ndarray, P: np.ndarray, measured: np.ndarray, variance: float
                     ) -> float:
    """
    Replace x and P by those after a measured rate; return the logarithm of its likelihood.

    K = P H^T S^-1 with H = [0 I 0 I], S = H P H^T + R; x <- x + K z, P <- P - K H P.
    """
    n = len(P)
    cross, S, z = np.empty((n, 3)), np.empty((3, 3)), np.empty(3)
    for i in range(n):
        for k in range(3):
            cross[i, k] = P[i, 3 + k] + P[i, 9 + k]
    for i in range(3):
        for k in range(3):
            S[i, k] = cross[3 + i, k] + cross[9 + i, k]
        S[i, i] += variance
        z[i] = measured[i] - x[3 + i] - x[9 + i]
    information = inverse(S)
    gain, log = product(cross, information), math.log(determinant(S))
    for i in range(n):
        for k in range(i + 1):
            P[i, k] -= gain[i, 0] * cross[k, 0] + gain[i, 1] * cross[k, 1] + (
                gain[i, 2] * cross[k, 2])
            P[k, i] = P[i, k]
    x += times(gain, z)
    return -(log + inner(z, times(information, z))) / 2


@compiled
def _by_logs(weight: np.ndarray, logs: np.ndarray) -> np.ndarray:
    """Return weights (M,) times likelihoods of these logarithms, normalised."""
    after = np.maximum(weight, 1e-300) * np.exp(logs - logs.max())
    return after / after.sum()


@compiled
def by_experience(weight: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Return the weights (M,) after a frame, without LEAST_NEXT: of what has been seen."""
    seen = weight * (share + LEAST_SHARE) / (share + LEAST_NEXT)
    return seen / seen.sum()


@compiled
def _about_mean(motion: Motion) -> Motion:
    """Return the motion with the mean attitude as its quaternion."""
    shift = np.zeros(3)
    for j in range(len(motion.weight)):
        shift += motion.weight[j] * motion.mean[j, :3]
    quaternion = turned(motion.quaternion, shift)
    mean = motion.mean.copy()
    for j in range(len(mean)):
        mean[j, :3] = rotation_between(quaternion, turned(motion.quaternion, mean[j, :3]))
    return Motion(motion.stamp_ns, quaternion, mean, motion.covariance, motion.weight,
                  motion.share, motion.noise, motion.interval_s, motion.frames, motion.swing)


@compiled
def updated(motion: Motion, quaternion: np.ndarray, rate: np.ndarray, information: np.ndarray,
            vector: np.ndarray, beside: np.ndarray, moved: np.ndarray) -> Motion:
    """
    Return the motion updated by what the stars of a frame measure.

    information (3, 3) is that of their turn from a quaternion (4,), vector (3,) information times
    the turn; with (6, 6) and (6,) they measure the difference from a rate (3,) as well. An
    acceleration a changes what they measure by L a: rows of a rolling shutter, which were brought
    to one time by the motion that was assumed, moved by its acceleration, and long streaks. So do
    constants: beside (n, K) is L = [L_1; L_2] of the elements from the acceleration on, moved (n,)
    is L times what was assumed of them. With H = [I 0 L_1; 0 I L_2], Y the information, y the
    vector about the prediction of a mode, S = H P H^T:
    P <- P - P H^T (I + Y S)^-1 Y H P, x <- x + P H^T (I + Y S)^-1 y, and
    -2 log L = log det(I + Y S) + d^T Y d - y^T S (I + Y S)^-1 y, d the measurement from there.
    """
    count, n, size = len(motion.weight), len(vector), motion.mean.shape[1]
    mean, covariance, logs = motion.mean.copy(), motion.covariance.copy(), np.empty(count)
    base, H_T = np.zeros(n), np.zeros((size, n))
    base[:3] = rotation_between(motion.quaternion, quaternion)
    if n > 3:
        base[3:] = rate
    base += moved
    H_T[:n], H_T[6:6 + beside.shape[1]] = np.eye(n), beside.T
    H = np.ascontiguousarray(H_T.T)
    for j in range(count):
        if motion.weight[j] == 0:
            logs[j] = -np.inf
            continue
        P = covariance[j]
        columns = product(P, H_T)
        S, away = product(H, columns), base - times(H, mean[j])
        seen = times(information, away)
        y = vector + seen
        solved, det = inverse_and_determinant(np.eye(n) + product(information, S))
        gained, rows = times(solved, y), product(columns, product(solved, information))
        for i in range(size):
            for k in range(i + 1):
                total = 0.0
                for m in range(n):
                    total += rows[i, m] * columns[k, m]
                P[i, k] -= total
                P[k, i] = P[i, k]
        mean[j] += times(columns, gained)
        logs[j] = -(math.log(det) + 2 * inner(away, vector) + inner(away, seen)
                    - inner(y, times(S, gained))) / 2
    weight = _by_logs(motion.weight, logs)
    frames = min(motion.frames + 1, MOST_FRAMES)
    share = motion.share + (by_experience(weight, motion.share) - motion.share) / frames
    return _about_mean(Motion(motion.stamp_ns, motion.quaternion, mean, covariance, weight, share,
                              motion.noise, motion.interval_s, frames, motion.swing))


@compiled
def with_measured(motion: Motion, before_ns: int, quaternion: np.ndarray, R: np.ndarray
                  ) -> Motion:
    """
    Return the motion that knows the noise of a frame and the frequency of a swing.

    quaternion (4,) is what the stars of the frame measure, of covariance R (3, 3), before_ns the
    stamp of the frame before.
    """
    noise, swing = motion.noise.copy(), motion.swing.copy()
    dt_s = (motion.stamp_ns - before_ns) * 1e-9
    for axis in range(3):
        noise[axis] = NOISE_MEMORY * noise[axis] + (1 - NOISE_MEMORY) * R[axis, axis]
    evenly = abs(dt_s - motion.interval_s) < 0.1 * motion.interval_s
    interval_s = dt_s if not evenly and dt_s < motion.interval_s else (
        NOISE_MEMORY * motion.interval_s + (1 - NOISE_MEMORY) * dt_s)
    turn = rotation_between(swing[LAST], quaternion)
    if not evenly:
        turn[:] = np.nan
    change = turn - swing[TURN]
    product = energy = 0.0
    for axis in range(3):
        a, b, c = change[axis], swing[CHANGE][axis], swing[OLDER][axis]
        # Noise of the attitudes gives b^2 a mean of 6 R, b (a + c) one of -8 R.
        product += b * (a + c) / R[axis, axis] + 8.0
        energy += b * b / R[axis, axis] - 6.0
    if not math.isnan(product):
        swing[PRODUCT] = SWING_MEMORY * swing[PRODUCT] + product
        swing[ENERGY] = SWING_MEMORY * swing[ENERGY] + energy
        swing[W2] = 0.0
        if swing[ENERGY] > SIGNIFICANT_ENERGY:
            b = min(max(swing[PRODUCT] / swing[ENERGY], FASTEST), 2.0)
            swing[W2] = (math.acos(b / 2) / dt_s) ** 2
    if swing[W2] == 0:
        swing[WEIGHT] = 0.0
    elif not math.isnan(product):
        # turn_k + turn_k-2 - b turn_k-1 = (2 - b) times the mean turn.
        mean = swing[TURN] + (change - swing[CHANGE]) / (2 - 2 * math.cos(
            math.sqrt(swing[W2]) * dt_s))
        swing[WEIGHT] = SWING_MEMORY * swing[WEIGHT] + 1
        swing[CENTRE] += (mean / dt_s - swing[CENTRE]) / swing[WEIGHT]
    swing[OLDER], swing[CHANGE], swing[TURN], swing[LAST] = (
        swing[CHANGE].copy(), change, turn, quaternion)
    return Motion(motion.stamp_ns, motion.quaternion, motion.mean, motion.covariance,
                  motion.weight, motion.share, noise, interval_s, motion.frames, swing)


@compiled
def tail_sigmas(probability: float, missed: float) -> float:
    """
    Return the c beyond which such an error lies on one side with no more than a probability.

    The error itself has the probability p: p exp(-c^2 / 2) / 2 = missed (a bound of the normal
    integral). 0 where no c is needed.
    """
    if probability <= 2 * missed:
        return 0.0
    return math.sqrt(2 * math.log(probability / (2 * missed)))


@compiled
def least_variances(weight: np.ndarray, mean: np.ndarray, covariance: np.ndarray, missed: float
                    ) -> np.ndarray:
    """Return the variances (6,) with which a mode makes turn and rate wrong so improbably."""
    least = np.zeros(6)
    middle = np.zeros(6)
    for j in range(len(weight)):
        middle += weight[j] * mean[j, :6]
    for j in range(len(weight)):
        tail = tail_sigmas(weight[j], missed)
        if tail == 0:
            continue
        for k in range(6):
            away = abs(mean[j, k] - middle[k]) + tail * math.sqrt(covariance[j, k, k])
            least[k] = max(least[k], (away / WRONG_SIGMAS) ** 2)
    return least


@compiled
def with_tails(motion: Motion, covariance: np.ndarray) -> np.ndarray:
    """Return a covariance (6, 6) of turn and rate with no less than least_variances()."""
    least = least_variances(motion.weight, motion.mean, motion.covariance, MISSED)
    # When a motion begins does not show in the rate of a frame: of what has been seen.
    least[3:] = least_variances(by_experience(motion.weight, motion.share), motion.mean,
                                motion.covariance, MISSED)[3:]
    after = covariance.copy()
    np.fill_diagonal(after, np.maximum(np.diag(after), least))
    return after


@compiled
def of_vibration(motion: Motion) -> np.ndarray:
    """
    Return the covariance (6, 6) of turn and rate that a vibration adds, zero without.

    A swing of w with fewer than four frames in a period is a vibration, within each exposure, with
    A = sum mu (r r^T + a a^T / w^2) / w^2 the square of its amplitude, from the rate r less its
    mean and the acceleration a of each mode. The frames do not tell its frequency w from
    2 pi / dt - w, at which the body turns the other way: rates that differ by 2 pi / dt sqrt(A).
    """
    added, swing = np.zeros((6, 6)), motion.swing
    w2 = swing[W2]
    if math.sqrt(w2) * motion.interval_s < math.pi / 2:
        return added
    for j in range(len(motion.weight)):
        if KIND[j] == SWING:
            rate, acceleration = motion.mean[j, 3:6] - swing[CENTRE], motion.mean[j, 6:9]
            for i in range(3):
                for k in range(3):
                    added[i, k] += motion.weight[j] / w2 * (
                        rate[i] * rate[k] + acceleration[i] * acceleration[k] / w2)
    added[3:, 3:] = added[:3, :3] * ((2 * math.pi / motion.interval_s) ** 2 / 2)
    added[:3, :3] *= SEEN_UNEVENLY ** 2
    return added


@compiled
def lacking(covariance: np.ndarray, error: np.ndarray, across: float, probability: float
            ) -> np.ndarray:
    """
    Return what a covariance (3, 3) lacks for an error (3,) that is possible, zero for nothing.

    With the probability of the error, the attitude is to be beyond WRONG_SIGMAS by it with the
    probability MISSED_LIGHT: within c of WRONG_SIGMAS, as of tail_sigmas(). As much of the square
    of the error is added as makes its Mahalanobis distance WRONG_SIGMAS - c (Sherman, Morrison),
    and for every axis as much as an error of the size across needs there.
    """
    nothing = np.zeros((3, 3))
    tail = tail_sigmas(probability, MISSED_LIGHT)
    if tail == 0:
        return nothing
    most = max(WRONG_SIGMAS - tail, 1.0)
    distance2 = error @ (inverse(covariance) @ error)
    if distance2 <= most * most:
        return nothing
    added = 1 / (most * most) - 1 / distance2
    return added * (np.outer(error, error) + across ** 2 * np.eye(3))


@compiled
def ahead(motion: Motion, weight: np.ndarray, mean: np.ndarray, covariance: np.ndarray,
          tau_s: float, acceleration: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return mean (6,) and covariance (6, 6) of turn and rate in tau_s, before or after.

    Modes have weight (M,), mean (M, N) and covariance (M, N, N), those after the frame mixed().
    One with a probability below MISSED_AHEAD is left out.
    """
    after, P, swing = np.zeros((len(weight), 6)), np.zeros((len(weight), 6, 6)), motion.swing
    used = np.where(weight < MISSED_AHEAD, 0.0, weight)
    for j in range(len(weight)):
        if used[j] == 0:
            continue
        x, whole = mean[j].copy(), covariance[j].copy()
        turn = turn_of(x, KIND[j], tau_s, swing)
        F, Q = transition_and_noise(KIND[j], SIZE[j], tau_s, swing[W2], motion.noise,
                                    motion.interval_s, acceleration)
        A = matrix_from_rotation_vector(turn).T
        after[j, :3] = turn + A @ x[:3]
        _carry_mean(x, F, KIND[j], swing)
        after[j, 3:] = x[3:6]
        _carry(whole, A, F)
        if tau_s > 0:
            _add_noise(whole, Q)
        P[j] = whole[:6, :6]
    middle, both = mixture(used, after, P)
    least = least_variances(used, after, P, MISSED_AHEAD)
    for k in range(6):
        both[k, k] = max(both[k, k], least[k])
    return middle, both


@compiled
def course(motion: Motion, acceleration: np.ndarray
           ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """
    Return how attitude and rate go on: mean, sigma, jerk and before (3,) of Acceleration.

    The cubic turn is that through the predictions one frame interval before and after. What these
    and those two intervals away have beside it is the sigma.
    """
    dt_s, own = motion.interval_s, by_experience(motion.weight, motion.share)
    weight, mixed_mean, mixed_P = mixed(motion, own, acceleration, LEAST_SHARE)
    now, P = ahead(motion, own, motion.mean, motion.covariance, 0.0, acceleration)
    turns, covariances = np.empty((4, 3)), np.empty((4, 6, 6))
    times_s = np.array([-2 * dt_s, -dt_s, dt_s, 2 * dt_s])
    for k in range(4):
        if times_s[k] < 0:
            found, covariances[k] = ahead(motion, own, motion.mean, motion.covariance, times_s[k],
                                          acceleration)
        else:
            found, covariances[k] = ahead(motion, weight, mixed_mean, mixed_P, times_s[k],
                                          acceleration)
        turns[k] = found[:3]
    mean = (turns[1] + turns[2] - 2 * now[:3]) / dt_s ** 2
    jerk = 3 * (turns[2] - turns[1] - 2 * dt_s * now[3:]) / dt_s ** 3
    variance = np.zeros((2, 3))
    for k in range(4):
        t = times_s[k]
        cubic = now[:3] + t * (now[3:] + t / 2 * (mean + t / 3 * jerk))
        for axis in range(3):
            rate = 3 + axis
            known = P[axis, axis] + 2 * t * P[axis, rate] + t * t * P[rate, rate]
            turned_by = covariances[k, axis, axis] - known + (turns[k, axis] - cubic[axis]) ** 2
            variance[k // 2, axis] = max(
                variance[k // 2, axis], 4 * turned_by / t ** 4,
                (covariances[k, rate, rate] - P[rate, rate]) / (t * t))
    # Where the jerk is not known, as on the wire, it is an error within half an interval.
    unknown2 = (jerk * (dt_s / 6)) ** 2
    return mean, np.sqrt(variance[1] + unknown2), jerk, np.sqrt(variance[0] + unknown2)
