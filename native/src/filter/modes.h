// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The modes of a motion, one step of each: their mixture, transition and noise.
//
// For the files of motion.h alone, which is where to start reading.

#pragma once

#include <cmath>

#include "filter/motion.h"

namespace st {

constexpr double STAYS = 0.95;        // probability that a mode lasts to the next frame
constexpr double NEGLIGIBLE = 1e-2;   // share of a mode that is not mixed into it
constexpr double LEAST_SPREAD = 0.1;  // of jumps about an axis, to the largest one
constexpr double LEAST_SHARE = 1e-4;  // of modes that were not seen for long

/// The elements of the error state of a mode that a state has: not the acceleration.
constexpr int of_mode(int element) {
    return element < ACCELERATION ? element : element + 3;
}

/// Return the larger one; a where it is NaN.
inline double larger(double a, double b) {
    return b > a ? b : a;
}

/// Return three elements of the error state of a mode.
inline Vector3 part(const double *state, int first) {
    return {{state[first], state[first + 1], state[first + 2]}};
}

double sum(const Weights &weight);
Weights normalised(Weights weight);

/// Return the least shares of all modes, in the next frame or further ahead.
Weights least_shares(bool in_next_frame);

/// Fill mean and covariance of a mixture by weights w, not normalised:
///
///     x = sum w_k x_k,  P = sum w_k (P_k + (x_k - x) (x_k - x)^T)
template <int N>
void mix(const Weights &weight, const Vector<N> *const *x, const Matrix<N, N> *const *P, int n,
         Vector<N> &mean, Matrix<N, N> &covariance) {
    const double total = sum(weight);
    for (int i = 0; i < n; ++i) {
        mean[i] = 0.0;
        for (int j = 0; j < n; ++j) {
            covariance[i][j] = 0.0;
        }
    }
    for (int k = 0; k < MODES; ++k) {
        if (weight[k] > 0) {
            const double share = weight[k] / total;
            for (int i = 0; i < n; ++i) {
                mean[i] += share * (*x[k])[i];
            }
        }
    }
    for (int k = 0; k < MODES; ++k) {
        if (weight[k] == 0) {
            continue;
        }
        const double share = weight[k] / total;
        Vector<N> away;
        for (int i = 0; i < n; ++i) {
            away[i] = (*x[k])[i] - mean[i];
        }
        for (int i = 0; i < n; ++i) {
            const double *row = (*P[k])[i];
            for (int j = 0; j < n; ++j) {
                covariance[i][j] += share * (row[j] + away[i] * away[j]);
            }
        }
    }
}

/// The mixture of modes.
template <int MOST>
void mix(const Weights &weight, const ModeState<MOST> *modes, int n, ModeState<MOST> &mixture) {
    const Vector<CONSTANT + MOST> *x[MODES];
    const Matrix<CONSTANT + MOST, CONSTANT + MOST> *P[MODES];
    for (int k = 0; k < MODES; ++k) {
        x[k] = &modes[k].mean;
        P[k] = &modes[k].covariance;
    }
    mix(weight, x, P, n, mixture.mean, mixture.covariance);
}

/// Return the sigmas of a frame that the prediction of a mode is off by.
double sigmas_of(const Mode &mode, const Vector3 &noise_rad2, double interval_s,
                 const Vector3 &acceleration);

/// Fill the modes before a prediction and return their weights: each is what the modes before,
/// with weights mu, come to if it is the one that goes on, in the next frame or in any after it. No
/// mode but the first has more than the largest acceleration of the jumps.
template <int MOST>
Weights mix_modes(const MotionWith<MOST> &motion, const Weights &before,
                  const Vector3 &acceleration, bool in_next_frame, ModeState<MOST> *modes) {
    const double most =
        sigmas_of(MODE[MODES - 1], motion.noise_rad2, motion.interval_s, acceleration);
    Weights share = motion.share + least_shares(in_next_frame), jumps{};
    for (int j = 0; j < MODES; ++j) {
        // Without a frequency it is the torque of the same size.
        if (MODE[j].kind == Kind::SWING && motion.swing.w2 == 0) {
            share[j] = 0.0;
        }
        const double sigmas =
            sigmas_of(MODE[j], motion.noise_rad2, motion.interval_s, acceleration);
        if (j > 0 && MODE[j].kind != Kind::JUMP && sigmas > most) {
            share[j] = 0.0;
        }
        if (in_next_frame && (SUDDEN >> j & 1U) != 0 && sigmas > WRONG_SIGMAS) {
            jumps[j] = std::fmin(motion.share[j], MODE[j].least_next);
        }
    }
    share = normalised(share);
    // A body that jumps does so whatever it did in the frame before.
    const double stays = STAYS * (1 - sum(jumps));
    Weights weight;
    for (int j = 0; j < MODES; ++j) {
        Weights to_j = scaled(before, (1 - STAYS) * share[j] + STAYS * jumps[j]);
        to_j[j] += before[j] * stays;
        weight[j] = sum(to_j);
        if (weight[j] == 0) {
            modes[j] = motion.mode[j];
            continue;
        }
        // What hardly any of a mode comes from would widen it all the same, in each frame.
        for (double &from : to_j.element) {
            from = from < NEGLIGIBLE * weight[j] ? 0.0 : from;
        }
        mix(to_j, motion.mode, motion.size(), modes[j]);
    }
    return weight;
}

/// Return the noise of a frame that a mode is in units of: that of sudden torques is smaller about
/// axes about which the body was hardly seen to jump. A jump about one of them alone would seem
/// improbable otherwise, as the others did not move.
Vector3 noise_of(const Mode &mode, const Vector3 &noise_rad2, const Vector3 &jumps);

/// F of [turn, rate, acceleration], the same for each axis and without the turn of the axes, and Q
/// of each axis.
struct Transition {
    Matrix3 F;
    Matrix3 Q[3];
};

/// Of white acceleration of density q in a time t, Q of turn and rate is [t^3 / 3, t^2 / 2; ., t]
/// q; of white jerk Q is [t^5 / 20, t^4 / 8, t^3 / 6; ., t^3 / 3, t^2 / 2; ., ., t] q (Bar-Shalom,
/// Li and Kirubarajan, 6.2.2 and 6.2.3). A swing of w turns [rate - r, acceleration] by w t.
Transition transition_of(const Mode &mode, double tau_s, double w2, const Vector3 &noise_rad2,
                         double interval_s, const Vector3 &acceleration);

/// P <- Phi P Phi^T, Phi = [A F_01 I F_02 I; 0 F_11 I F_12 I; 0 F_21 I F_22 I] of turn, rate and
/// acceleration, the identity of what follows. A turns the axes.
template <int N>
void carry(Matrix<N, N> &P, int n, const Matrix3 &A, const Matrix3 &F) {
    for (int k = 0; k < n; ++k) {
        const double x = P[0][k], y = P[1][k], z = P[2][k];
        for (int i = 0; i < 3; ++i) {
            const double rate = P[RATE + i][k], more = P[ACCELERATION + i][k];
            P[i][k] = A[i][0] * x + A[i][1] * y + A[i][2] * z + F[0][1] * rate + F[0][2] * more;
            P[RATE + i][k] = F[1][1] * rate + F[1][2] * more;
            P[ACCELERATION + i][k] = F[2][1] * rate + F[2][2] * more;
        }
    }
    for (int k = 0; k < n; ++k) {
        double *row = P[k];
        const double x = row[0], y = row[1], z = row[2];
        for (int i = 0; i < 3; ++i) {
            const double rate = row[RATE + i], more = row[ACCELERATION + i];
            row[i] = A[i][0] * x + A[i][1] * y + A[i][2] * z + F[0][1] * rate + F[0][2] * more;
            row[RATE + i] = F[1][1] * rate + F[1][2] * more;
            row[ACCELERATION + i] = F[2][1] * rate + F[2][2] * more;
        }
    }
}

/// P <- P + Q.
template <int N>
void add_noise(Matrix<N, N> &P, const Transition &step) {
    for (int axis = 0; axis < 3; ++axis) {
        for (int i = 0; i < 3; ++i) {
            for (int k = 0; k < 3; ++k) {
                P[3 * i + axis][3 * k + axis] += step.Q[axis][i][k];
            }
        }
    }
}

/// Return the turn of a body with the rate and acceleration of a mode in a time.
///
/// Of a swing about the mean rate r: t r + sin(w t) / w (rate - r) + (1 - cos(w t)) / w^2
/// acceleration.
Vector3 turn_of(const double *mean, Kind kind, double tau_s, const Swing &swing);

/// Replace the mean of a mode by that after its transition; its turn is zero.
void carry_mean(double *mean, const Matrix3 &F, Kind kind, const Swing &swing);

}  // namespace st
