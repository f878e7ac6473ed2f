// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// What is published of a motion: covariances that are wide enough, and how it goes on.

#include <cmath>

#include "filter/modes.h"
#include "filter/motion.h"
#include "maths/symmetric.h"

namespace st {

namespace {

// Of the amplitude of a vibration: what the fit of a star that it moves within the exposure is off
// by, 1 sigma.
constexpr double SEEN_UNEVENLY = 0.07;

double square(double x) {
    return x * x;
}

/// Return the variances of turn and rate with which a mode makes them wrong so improbably.
template <int N>
Vector<6> least_variances(const Weights &weight, const Vector<N> *const *x,
                          const Matrix<N, N> *const *P, double missed) {
    Vector<6> least{}, middle{};
    for (int j = 0; j < MODES; ++j) {
        for (int k = 0; k < 6; ++k) {
            middle[k] += weight[j] * (*x[j])[k];
        }
    }
    for (int j = 0; j < MODES; ++j) {
        const double tail = tail_sigmas(weight[j], missed);
        if (tail == 0) {
            continue;
        }
        for (int k = 0; k < 6; ++k) {
            const double away =
                std::fabs((*x[j])[k] - middle[k]) + tail * std::sqrt((*P[j])[k][k]);
            least[k] = larger(least[k], square(away / WRONG_SIGMAS));
        }
    }
    return least;
}

/// Turn and rate with their covariance.
struct TurnAndRate {
    Vector<6> mean;
    Matrix<6, 6> covariance;
};

/// Return those in tau_s, before or after, of modes with these weights; those after the frame are
/// mixed before. A mode with a probability below MISSED_AHEAD is left out.
TurnAndRate ahead(const Motion &motion, const Weights &weight, const ModeState<0> *modes,
                  double tau_s, const Vector3 &acceleration) {
    constexpr int SIZE = DRIFT;  // what is beyond does not change turn and rate
    Vector<6> mean[MODES];
    Matrix<6, 6> covariance[MODES];
    const Vector<6> *x[MODES];
    const Matrix<6, 6> *P[MODES];
    Weights used;
    for (int j = 0; j < MODES; ++j) {
        used[j] = weight[j] < MISSED_AHEAD ? 0.0 : weight[j];
        mean[j] = {};
        covariance[j] = {};
        x[j] = &mean[j];
        P[j] = &covariance[j];
        if (used[j] == 0) {
            continue;
        }
        const Mode &mode = MODE[j];
        Vector<CONSTANT> state = modes[j].mean;
        auto whole = block<SIZE, SIZE>(modes[j].covariance, 0, 0);
        const Vector3 turn = turn_of(state.element, mode.kind, tau_s, motion.swing);
        const Transition step = transition_of(mode, tau_s, motion.swing.w2,
                                              noise_of(mode, motion.noise_rad2, motion.jumps),
                                              motion.interval_s, acceleration);
        const Matrix3 A = transposed(matrix_from_rotation_vector(turn));
        const Vector3 turned_by = turn + A * part(state.element, TURN);
        carry_mean(state.element, step.F, mode.kind, motion.swing);
        for (int i = 0; i < 3; ++i) {
            mean[j][i] = turned_by[i];
            mean[j][3 + i] = state[RATE + i];
        }
        carry(whole, SIZE, A, step.F);
        if (tau_s > 0) {
            add_noise(whole, step);
        }
        covariance[j] = block<6, 6>(whole, 0, 0);
    }
    TurnAndRate both;
    mix(used, x, P, 6, both.mean, both.covariance);
    const Vector<6> least = least_variances(used, x, P, MISSED_AHEAD);
    for (int k = 0; k < 6; ++k) {
        both.covariance[k][k] = larger(both.covariance[k][k], least[k]);
    }
    return both;
}

}  // namespace

double tail_sigmas(double probability, double missed) {
    if (probability <= 2 * missed) {
        return 0.0;
    }
    return std::sqrt(2 * std::log(probability / (2 * missed)));
}

template <int MOST>
Matrix<6, 6> with_tails(const MotionWith<MOST> &motion, Matrix<6, 6> covariance) {
    const Vector<CONSTANT + MOST> *x[MODES];
    const Matrix<CONSTANT + MOST, CONSTANT + MOST> *P[MODES];
    for (int j = 0; j < MODES; ++j) {
        x[j] = &motion.mode[j].mean;
        P[j] = &motion.mode[j].covariance;
    }
    const Vector<6> turn = least_variances(motion.weight, x, P, MISSED);
    // When a motion begins does not show in the rate of a frame: of what has been seen.
    const Vector<6> rate =
        least_variances(by_experience(motion.weight, motion.share), x, P, MISSED);
    for (int k = 0; k < 6; ++k) {
        covariance[k][k] = larger(covariance[k][k], k < 3 ? turn[k] : rate[k]);
    }
    return covariance;
}

/// A swing of w with fewer than four frames in a period is a vibration, within each exposure, with
///
///     A = sum mu (r r^T + a a^T / w^2) / w^2
///
/// the square of its amplitude, from the rate r less its mean and the acceleration a of each mode.
/// The frames do not tell its frequency w from 2 pi / dt - w, at which the body turns the other
/// way: rates that differ by 2 pi / dt sqrt(A).
Matrix<6, 6> vibration_covariance(const Motion &motion) {
    Matrix<6, 6> added{};
    const double w2 = motion.swing.w2;
    if (std::sqrt(w2) * motion.interval_s < M_PI / 2) {
        return added;
    }
    Matrix3 A{};
    for (int j = 0; j < MODES; ++j) {
        if (MODE[j].kind != Kind::SWING) {
            continue;
        }
        const double *mean = motion.mode[j].mean.element;
        const Vector3 r = part(mean, RATE) - motion.swing.centre, a = part(mean, ACCELERATION);
        for (int i = 0; i < 3; ++i) {
            for (int k = 0; k < 3; ++k) {
                A[i][k] += motion.weight[j] / w2 * (r[i] * r[k] + a[i] * a[k] / w2);
            }
        }
    }
    const double frequency2 = square(2 * M_PI / motion.interval_s) / 2;
    for (int i = 0; i < 3; ++i) {
        for (int k = 0; k < 3; ++k) {
            added[i][k] = A[i][k] * square(SEEN_UNEVENLY);
            added[3 + i][3 + k] = A[i][k] * frequency2;
        }
    }
    return added;
}

/// With the probability of the error, the attitude is to be beyond WRONG_SIGMAS by it with the
/// probability MISSED_LIGHT: within c of WRONG_SIGMAS, as of tail_sigmas(). As much of the square
/// e e^T of the error is added as makes its Mahalanobis distance m = WRONG_SIGMAS - c: with d^2 =
/// e^T P^-1 e that is 1 / m^2 - 1 / d^2 (Sherman and Morrison, Ann. Math. Stat. 21, 1950), and for
/// every axis as much as an error of the size across needs there.
Matrix3 covariance_deficit(const Matrix3 &covariance, const Vector3 &error, double across,
                           double probability) {
    const double tail = tail_sigmas(probability, MISSED_LIGHT);
    if (tail == 0) {
        return {};
    }
    const double most = larger(WRONG_SIGMAS - tail, 1.0);
    const double distance2 = dot(error, inverse(covariance) * error);
    if (distance2 <= most * most) {
        return {};
    }
    const double added = 1 / (most * most) - 1 / distance2;
    Matrix3 deficit;
    for (int i = 0; i < 3; ++i) {
        for (int k = 0; k < 3; ++k) {
            deficit[i][k] = added * (error[i] * error[k] + (i == k ? across * across : 0.0));
        }
    }
    return deficit;
}

/// The cubic turn is that through the predictions one frame interval before and after:
///
///     turn(t) = turn + t (rate + t / 2 (acceleration + t / 3 jerk))
///
/// What these and those two intervals away have in addition to it is the sigma.
Course course_of(const Motion &motion, const Vector3 &acceleration_rad_s2) {
    const double dt_s = motion.interval_s;
    const Weights own = by_experience(motion.weight, motion.share);
    ModeState<0> mixed[MODES];
    const Weights next = mix_modes(motion, own, acceleration_rad_s2, false, mixed);
    const TurnAndRate now = ahead(motion, own, motion.mode, 0.0, acceleration_rad_s2);
    const double times_s[4] = {-2 * dt_s, -dt_s, dt_s, 2 * dt_s};
    TurnAndRate found[4];
    for (int k = 0; k < 4; ++k) {
        found[k] = times_s[k] < 0
                       ? ahead(motion, own, motion.mode, times_s[k], acceleration_rad_s2)
                       : ahead(motion, next, mixed, times_s[k], acceleration_rad_s2);
    }
    Course course;
    double variance[2][3] = {};
    for (int axis = 0; axis < 3; ++axis) {
        const double turn = now.mean[axis], rate = now.mean[3 + axis];
        const double before = found[1].mean[axis], after = found[2].mean[axis];
        const double mean = (before + after - 2 * turn) / (dt_s * dt_s);
        const double jerk = 3 * (after - before - 2 * dt_s * rate) / (dt_s * dt_s * dt_s);
        const Matrix<6, 6> &P = now.covariance;
        for (int k = 0; k < 4; ++k) {
            const double t = times_s[k];
            const Matrix<6, 6> &then = found[k].covariance;
            const double cubic = turn + t * (rate + t / 2 * (mean + t / 3 * jerk));
            const double known =
                P[axis][axis] + 2 * t * P[axis][3 + axis] + t * t * P[3 + axis][3 + axis];
            const double turned_by =
                then[axis][axis] - known + square(found[k].mean[axis] - cubic);
            const double rate_by = then[3 + axis][3 + axis] - P[3 + axis][3 + axis];
            double &most = variance[k / 2][axis];
            most = larger(most, larger(4 * turned_by / (t * t * t * t), rate_by / (t * t)));
        }
        // Where the jerk is not known, as on the wire, it is an error within half an interval.
        const double unknown2 = square(jerk * (dt_s / 6));
        course.acceleration_rad_s2[axis] = mean;
        course.jerk_rad_s3[axis] = jerk;
        course.sigma_rad_s2[axis] = std::sqrt(variance[1][axis] + unknown2);
        course.sigma_before_rad_s2[axis] = std::sqrt(variance[0][axis] + unknown2);
    }
    return course;
}

template Matrix<6, 6> with_tails(const Motion &, Matrix<6, 6>);
template Matrix<6, 6> with_tails(const MotionWith<MOST_CONSTANTS> &, Matrix<6, 6>);

}  // namespace st
