// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "filter/motion.h"

#include <cmath>

#include "maths/symmetric.h"

namespace st {

namespace {

constexpr double STAYS = 0.95;        // probability that a mode lasts to the next frame
constexpr double NEGLIGIBLE = 1e-2;   // share of a mode that is not mixed into it
constexpr double LEAST_SHARE = 1e-4;  // of modes that were not seen for long
constexpr double FIRST_FRAMES = 5.0, MOST_FRAMES = 200.0;  // that the shares are the means of
constexpr double SWING_MEMORY = 0.93;                      // of the sums of the fit of w
constexpr double FASTEST = -1.0;                           // 2 cos(w dt): three frames in a period
// Energy of a swing over the variance of the noise; that of noise: 55.
constexpr double SIGNIFICANT_ENERGY = 200.0;
constexpr double FIRST_ACCELERATION = M_PI / 180;  // rad/s^2, 1 sigma, before the first frame
// Of the amplitude of a vibration: what the fit of a star that it moves within the exposure is off
// by, 1 sigma.
constexpr double SEEN_UNEVENLY = 0.07;
constexpr double LARGEST_SIZE = MODE[MODES - 1].size;

/// The elements of the error state of a mode that a state has: not the acceleration.
constexpr int of_mode(int element) {
    return element < ACCELERATION ? element : element + 3;
}

double square(double x) {
    return x * x;
}

/// Return the larger one; a where it is NaN.
double larger(double a, double b) {
    return b > a ? b : a;
}

double largest(const Vector3 &v) {
    return larger(larger(v[0], v[1]), v[2]);
}

double sum(const Weights &weight) {
    double total = 0.0;
    for (double one : weight.element) {
        total += one;
    }
    return total;
}

Weights normalised(Weights weight) {
    const double total = sum(weight);
    for (double &one : weight.element) {
        one /= total;
    }
    return weight;
}

Vector3 part(const double *state, int first) {
    return {{state[first], state[first + 1], state[first + 2]}};
}

Weights least_shares(bool in_next_frame) {
    Weights least;
    for (int j = 0; j < MODES; ++j) {
        least[j] = in_next_frame ? MODE[j].least_next : LEAST_SHARE;
    }
    return least;
}

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

/// Fill the modes before a prediction and return their weights: each is what the modes before,
/// with weights mu, come to if it is the one that goes on. least are the least shares. No mode but
/// the first has more than the largest acceleration of the jumps.
template <int MOST>
Weights mix_modes(const MotionWith<MOST> &motion, const Weights &before,
                  const Vector3 &acceleration, const Weights &least, ModeState<MOST> *modes) {
    Weights share = motion.share + least;
    for (int j = 0; j < MODES; ++j) {
        // Without a frequency it is the torque of the same size.
        if (MODE[j].kind == Kind::SWING && motion.swing.w2 == 0) {
            share[j] = 0.0;
        }
        const double shown =
            MODE[j].size * std::sqrt(3 * motion.noise_rad2[0]) / square(motion.interval_s);
        if (j > 0 && MODE[j].kind != Kind::JUMP && shown > LARGEST_SIZE * largest(acceleration)) {
            share[j] = 0.0;
        }
    }
    share = normalised(share);
    Weights weight;
    for (int j = 0; j < MODES; ++j) {
        Weights to_j = scaled(before, (1 - STAYS) * share[j]);
        to_j[j] += before[j] * STAYS;
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

/// F of [turn, rate, acceleration], the same for each axis and without the turn of the axes, and Q
/// of each axis.
struct Transition {
    Matrix3 F;
    Matrix3 Q[3];
};

/// Of white acceleration of density q in a time t, Q of turn and rate is [t^3 / 3, t^2 / 2; ., t] q;
/// of white jerk Q is [t^5 / 20, t^4 / 8, t^3 / 6; ., t^3 / 3, t^2 / 2; ., ., t] q (Bar-Shalom, Li
/// and Kirubarajan, 6.2.2 and 6.2.3). A swing of w turns [rate - r, acceleration] by w t.
Transition transition_of(const Mode &mode, double tau_s, double w2, const Vector3 &noise_rad2,
                         double interval_s, const Vector3 &acceleration) {
    Transition step{identity<3>(), {}};
    Matrix3 &F = step.F;
    const double t = std::fabs(tau_s), t2 = t * t, t3 = t2 * t;
    F[0][1] = tau_s;
    if (mode.kind == Kind::STEADY || mode.kind == Kind::JUMP) {
        F[2][2] = 0.0;
        for (int axis = 0; axis < 3; ++axis) {
            Matrix3 &Q = step.Q[axis];
            const double a2 = square(mode.size * acceleration[axis]), q = a2 * interval_s;
            Q[0][0] = q * t3 / 3;
            Q[0][1] = Q[1][0] = q * tau_s * t / 2;
            Q[1][1] = q * t;
            // It may go on at any of these accelerations.
            Q[2][2] = mode.kind == Kind::JUMP ? a2 : 0.0;
        }
        return step;
    }
    F[0][2] = tau_s * tau_s / 2;
    F[1][2] = tau_s;
    if (mode.kind == Kind::SWING && w2 > 0) {
        const double w = std::sqrt(w2), sine = std::sin(w * tau_s), cosine = std::cos(w * tau_s);
        F = {{{1.0, sine / w, (1 - cosine) / w2},
              {0.0, cosine, sine / w},
              {0.0, -w * sine, cosine}}};
    }
    const double interval2 = interval_s * interval_s;
    for (int axis = 0; axis < 3; ++axis) {
        Matrix3 &Q = step.Q[axis];
        const double q =
            mode.size * mode.size * noise_rad2[axis] * 20 / (interval2 * interval2 * interval_s);
        Q[0][0] = q * t3 * t2 / 20;
        Q[1][1] = q * t3 / 3;
        Q[2][2] = q * t;
        Q[0][1] = Q[1][0] = q * t3 * tau_s / 8;
        Q[0][2] = Q[2][0] = q * t3 / 6;
        Q[1][2] = Q[2][1] = q * t * tau_s / 2;
    }
    return step;
}

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
Vector3 turn_of(const double *mean, Kind kind, double tau_s, const Swing &swing) {
    const Vector3 rate = part(mean, RATE), acceleration = part(mean, ACCELERATION);
    if (kind == Kind::STEADY || kind == Kind::JUMP) {
        return scaled(rate, tau_s);
    }
    if (kind == Kind::TORQUE || swing.w2 == 0) {
        return scaled(rate + scaled(acceleration, tau_s / 2), tau_s);
    }
    const double w = std::sqrt(swing.w2);
    return scaled(swing.centre, tau_s) + scaled(rate - swing.centre, std::sin(w * tau_s) / w) +
           scaled(acceleration, (1 - std::cos(w * tau_s)) / swing.w2);
}

/// Replace the mean of a mode by that after its transition; its turn is zero.
void carry_mean(double *mean, const Matrix3 &F, Kind kind, const Swing &swing) {
    const bool swings = kind == Kind::SWING && swing.w2 > 0;
    for (int i = 0; i < 3; ++i) {
        const double middle = swings ? swing.centre[i] : 0.0;
        const double rate = mean[RATE + i] - middle, more = mean[ACCELERATION + i];
        mean[TURN + i] = 0.0;
        mean[RATE + i] = F[1][1] * rate + F[1][2] * more + middle;
        mean[ACCELERATION + i] = F[2][1] * rate + F[2][2] * more;
    }
}

/// Update a mode by a measured rate, which is that of the body and the drift:
///
///     S = H P H^T + R with H = [0 I 0 I], K = P H^T S^-1, x <- x + K z, P <- P - K H P;
///
/// return the logarithm of its likelihood, -(log det S + z^T S^-1 z) / 2 (Bar-Shalom, Li and
/// Kirubarajan, 5.2).
template <int MOST>
double correct_by_rate(ModeState<MOST> &mode, int n, const Vector3 &measured, double variance) {
    auto &x = mode.mean;
    auto &P = mode.covariance;
    double cross[CONSTANT + MOST][3], gain[CONSTANT + MOST][3];
    for (int i = 0; i < n; ++i) {
        for (int k = 0; k < 3; ++k) {
            cross[i][k] = P[i][RATE + k] + P[i][DRIFT + k];
        }
    }
    Matrix3 S;
    Vector3 z;
    for (int i = 0; i < 3; ++i) {
        for (int k = 0; k < 3; ++k) {
            S[i][k] = cross[RATE + i][k] + cross[DRIFT + i][k];
        }
        S[i][i] += variance;
        z[i] = measured[i] - x[RATE + i] - x[DRIFT + i];
    }
    const Matrix3 information = inverse(S);
    for (int i = 0; i < n; ++i) {
        for (int k = 0; k < 3; ++k) {
            gain[i][k] = cross[i][0] * information[0][k] + cross[i][1] * information[1][k] +
                         cross[i][2] * information[2][k];
        }
        x[i] += gain[i][0] * z[0] + gain[i][1] * z[1] + gain[i][2] * z[2];
    }
    for (int i = 0; i < n; ++i) {
        for (int k = 0; k <= i; ++k) {
            P[i][k] -=
                gain[i][0] * cross[k][0] + gain[i][1] * cross[k][1] + gain[i][2] * cross[k][2];
            P[k][i] = P[i][k];
        }
    }
    return -(std::log(determinant(S)) + dot(z, information * z)) / 2;
}

/// Return weights times likelihoods of these logarithms, normalised.
Weights by_logs(const Weights &weight, const Weights &logs) {
    double largest_log = logs[0];
    for (double one : logs.element) {
        largest_log = one > largest_log ? one : largest_log;
    }
    Weights after;
    for (int j = 0; j < MODES; ++j) {
        after[j] = larger(weight[j], 1e-300) * std::exp(logs[j] - largest_log);
    }
    return normalised(after);
}

/// Make the mean attitude the quaternion of the motion.
template <int MOST>
void about_mean(MotionWith<MOST> &motion) {
    Vector3 shift{};
    for (int j = 0; j < MODES; ++j) {
        shift = shift + scaled(part(motion.mode[j].mean.element, TURN), motion.weight[j]);
    }
    const Quaternion mean = turned(motion.quaternion, shift);
    for (ModeState<MOST> &mode : motion.mode) {
        const Vector3 turn =
            rotation_between(mean, turned(motion.quaternion, part(mode.mean.element, TURN)));
        for (int i = 0; i < 3; ++i) {
            mode.mean[TURN + i] = turn[i];
        }
    }
    motion.quaternion = mean;
}

/// Update a mode by what stars measure, SIZE elements, and return the logarithm of its likelihood.
///
/// With H = [I 0 L_1; 0 I L_2], Y the information, y the vector about the prediction of the mode,
/// d the measurement from there and S = H P H^T:
///
///     P <- P - P H^T (I + Y S)^-1 Y H P,  x <- x + P H^T (I + Y S)^-1 y,
///     -2 log L = log det(I + Y S) + d^T Y d - y^T S (I + Y S)^-1 y
///
/// (the information filter, without an inverse of Y, which may be singular). Columns of L from last
/// on are zero, as those before first.
template <int SIZE, int MOST>
double correct_by_stars(const Matrix<SIZE, SIZE> &Y, const Vector<SIZE> &vector,
                        const Vector<SIZE> &base, const double *const *L, int first, int last,
                        ModeState<MOST> &mode, int n) {
    auto &x = mode.mean;
    auto &P = mode.covariance;
    double columns[CONSTANT + MOST][SIZE], rows[CONSTANT + MOST][SIZE];
    for (int i = 0; i < n; ++i) {
        for (int k = 0; k < SIZE; ++k) {
            columns[i][k] = P[i][k];
            for (int j = first; j < last; ++j) {
                columns[i][k] += P[i][ACCELERATION + j] * L[k][j];
            }
        }
    }
    Matrix<SIZE, SIZE> S;
    Vector<SIZE> away;
    for (int i = 0; i < SIZE; ++i) {
        double predicted = x[i];
        for (int j = first; j < last; ++j) {
            predicted += L[i][j] * x[ACCELERATION + j];
        }
        away[i] = base[i] - predicted;
        for (int k = 0; k < SIZE; ++k) {
            S[i][k] = columns[i][k];
            for (int j = first; j < last; ++j) {
                S[i][k] += L[i][j] * columns[ACCELERATION + j][k];
            }
        }
    }
    const Vector<SIZE> seen = Y * away, y = vector + seen;
    double det;
    const auto solved = inverse_and_determinant(identity<SIZE>() + Y * S, det);
    const Vector<SIZE> gained = solved * y;
    const auto gain = solved * Y;
    for (int i = 0; i < n; ++i) {
        double change = 0.0;
        for (int k = 0; k < SIZE; ++k) {
            rows[i][k] = 0.0;
            for (int m = 0; m < SIZE; ++m) {
                rows[i][k] += columns[i][m] * gain[m][k];
            }
            change += columns[i][k] * gained[k];
        }
        x[i] += change;
    }
    for (int i = 0; i < n; ++i) {
        for (int k = 0; k <= i; ++k) {
            double total = 0.0;
            for (int m = 0; m < SIZE; ++m) {
                total += rows[i][m] * columns[k][m];
            }
            P[i][k] -= total;
            P[k][i] = P[i][k];
        }
    }
    return -(std::log(det) + 2 * dot(away, vector) + dot(away, seen) - dot(y, S * gained)) / 2;
}

/// Update all modes by SIZE elements, and return the logarithms of their likelihoods.
template <int SIZE, int MOST>
Weights correct_modes(const MotionMeasurement<MOST> &measured, MotionWith<MOST> &motion) {
    const auto Y = block<SIZE, SIZE>(measured.stars.information, 0, 0);
    const auto vector = st::first<SIZE>(measured.stars.vector);
    const Vector3 turn = rotation_between(motion.quaternion, measured.quaternion);
    Vector<SIZE> base;
    const double *L[SIZE];
    const int n = motion.size();
    int first = n - ACCELERATION, last = 0;
    for (int i = 0; i < SIZE; ++i) {
        base[i] = (i < 3 ? turn[i] : measured.rate_rad_s[i % 3]) + measured.moved[i];
        L[i] = measured.beside[i];
        for (int j = 0; j < n - ACCELERATION; ++j) {
            if (L[i][j] != 0) {
                first = j < first ? j : first;
                last = j >= last ? j + 1 : last;
            }
        }
    }
    Weights logs;
    for (int j = 0; j < MODES; ++j) {
        logs[j] = motion.weight[j] == 0
                      ? -INFINITY
                      : correct_by_stars(Y, vector, base, L, first, last, motion.mode[j], n);
    }
    return logs;
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
        const Transition step = transition_of(mode, tau_s, motion.swing.w2, motion.noise_rad2,
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

// --- the state ---

template <int MOST>
void start_motion(const StateWith<MOST> &state, const double *constants, const Vector3 &noise_rad2,
                  double interval_s, MotionWith<MOST> &motion) {
    motion.stamp_ns = state.stamp_ns;
    motion.quaternion = state.quaternion;
    motion.constants = state.constants;
    motion.noise_rad2 = noise_rad2;
    motion.interval_s = interval_s;
    motion.frames = FIRST_FRAMES;
    motion.swing = {};
    interrupt_motion(motion);
    for (int j = 0; j < MODES; ++j) {
        motion.share[j] = MODE[j].first_share;
        ModeState<MOST> &mode = motion.mode[j];
        mode = {};
        for (int k = 0; k < 3; ++k) {
            mode.mean[RATE + k] = state.rate_rad_s[k];
            mode.mean[DRIFT + k] = state.drift_rad_s[k];
        }
        for (int k = 0; k < state.constants.count; ++k) {
            mode.mean[CONSTANT + k] = constants[k];
        }
        for (int i = 0; i < state.size(); ++i) {
            for (int k = 0; k < state.size(); ++k) {
                mode.covariance[of_mode(i)][of_mode(k)] = state.covariance[i][k];
            }
        }
        if (MODE[j].kind == Kind::TORQUE || MODE[j].kind == Kind::SWING) {
            for (int k = ACCELERATION; k < DRIFT; ++k) {
                mode.covariance[k][k] = square(FIRST_ACCELERATION);
            }
        }
    }
    motion.weight = motion.share = normalised(motion.share);
}

template <int MOST>
void restart_motion(const StateWith<MOST> &state, MotionWith<MOST> &motion) {
    double constants[MOST + 1] = {};
    for (int k = 0; k < motion.constants.count; ++k) {
        for (int j = 0; j < MODES; ++j) {
            constants[k] += motion.weight[j] * motion.mode[j].mean[CONSTANT + k];
        }
    }
    for (ModeState<MOST> &mode : motion.mode) {
        for (int k = 0; k < 3; ++k) {
            mode.mean[TURN + k] = 0.0;
            mode.mean[RATE + k] = state.rate_rad_s[k];
            mode.mean[DRIFT + k] = state.drift_rad_s[k];
        }
        for (int k = 0; k < motion.constants.count; ++k) {
            mode.mean[CONSTANT + k] = constants[k];
        }
        for (int i = 0; i < state.size(); ++i) {
            for (int k = 0; k < 3; ++k) {
                mode.covariance[ACCELERATION + k][of_mode(i)] = 0.0;
                mode.covariance[of_mode(i)][ACCELERATION + k] = 0.0;
            }
            for (int k = 0; k < state.size(); ++k) {
                mode.covariance[of_mode(i)][of_mode(k)] = state.covariance[i][k];
            }
        }
    }
    motion.stamp_ns = state.stamp_ns;
    motion.quaternion = state.quaternion;
    motion.weight = motion.share;
}

template <int MOST>
void resume_motion(const MotionWith<MOST> &known, MotionWith<MOST> &motion) {
    motion.weight = known.weight;
    motion.share = known.share;
    motion.noise_rad2 = known.noise_rad2;
    motion.interval_s = known.interval_s;
    motion.frames = known.frames;
    motion.swing = known.swing;
}

template <int MOST>
void interrupt_motion(MotionWith<MOST> &motion) {
    motion.swing.last = {NAN, NAN, NAN, NAN};
    motion.swing.turn = motion.swing.change = motion.swing.older = {{NAN, NAN, NAN}};
}

Weights weights_of(const Weights &weight, ModeSet modes) {
    Weights some;
    for (int j = 0; j < MODES; ++j) {
        some[j] = (modes >> j & 1U) != 0 ? weight[j] : 0.0;
    }
    return some;
}

double total_weight(const Weights &weight, ModeSet modes) {
    return sum(weights_of(weight, modes));
}

int most_probable_mode(const Weights &weight) {
    int best = 0;
    for (int j = 1; j < MODES; ++j) {
        best = weight[j] > weight[best] ? j : best;
    }
    return best;
}

template <int MOST>
StateWith<MOST> state_of(const MotionWith<MOST> &motion, const Weights &weight) {
    ModeState<MOST> mixture;
    mix(weight, motion.mode, motion.size(), mixture);
    StateWith<MOST> state;
    state.stamp_ns = motion.stamp_ns;
    state.constants = motion.constants;
    state.quaternion = turned(motion.quaternion, part(mixture.mean.element, TURN));
    state.rate_rad_s = part(mixture.mean.element, RATE);
    state.drift_rad_s = part(mixture.mean.element, DRIFT);
    for (int i = 0; i < state.size(); ++i) {
        for (int k = 0; k < state.size(); ++k) {
            state.covariance[i][k] = mixture.covariance[of_mode(i)][of_mode(k)];
        }
    }
    return state;
}

template <int MOST>
void constants_of(const MotionWith<MOST> &motion, const Weights &weight, double *constants) {
    const double total = sum(weight);
    for (int k = 0; k < motion.constants.count; ++k) {
        constants[k] = 0.0;
        for (int j = 0; j < MODES; ++j) {
            if (weight[j] > 0) {
                constants[k] += weight[j] / total * motion.mode[j].mean[CONSTANT + k];
            }
        }
    }
}

template <int MOST>
Vector3 acceleration_of(const MotionWith<MOST> &motion) {
    Vector3 acceleration{};
    for (int j = 0; j < MODES; ++j) {
        acceleration = acceleration +
                       scaled(part(motion.mode[j].mean.element, ACCELERATION), motion.weight[j]);
    }
    return acceleration;
}

// --- from frame to frame ---

template <int MOST>
void predict_motion(const MotionWith<MOST> &before, int64_t to_ns, const GyroRates &rates,
                    const ProcessNoise<MOST> &noise, MotionWith<MOST> &after) {
    const int n = before.size();
    const Swing &swing = before.swing;
    static_cast<MotionSummary<MOST> &>(after) = before;
    after.stamp_ns = to_ns;
    const Weights weight = mix_modes(before, before.weight, noise.acceleration_rad_s2,
                                     least_shares(true), after.mode);
    Weights logs{};
    Quaternion attitude[MODES];
    for (int j = 0; j < MODES; ++j) {
        attitude[j] = before.quaternion;
        if (weight[j] == 0) {
            logs[j] = -INFINITY;
            continue;
        }
        const Mode &mode = MODE[j];
        double *x = after.mode[j].mean.element;
        auto &P = after.mode[j].covariance;
        Quaternion q = turned(before.quaternion, part(x, TURN));
        for (int k = 0; k <= rates.count; ++k) {
            const double dt_s = rates.dt_s[k];
            const Quaternion turn =
                quaternion_from_rotation_vector(turn_of(x, mode.kind, dt_s, swing));
            const Transition step = transition_of(mode, dt_s, swing.w2, before.noise_rad2,
                                                  before.interval_s, noise.acceleration_rad_s2);
            carry_mean(x, step.F, mode.kind, swing);
            carry(P, n, transposed(matrix_from_quaternion(turn)), step.F);
            add_noise(P, step);
            for (int i = DRIFT; i < n; ++i) {
                P[i][i] += noise.walk[i - DRIFT] * dt_s;
            }
            q = normalised(multiply(q, turn));
            if (k < rates.count) {
                logs[j] +=
                    correct_by_rate(after.mode[j], n, rates.rate_rad_s[k], rates.variance[k]);
                q = turned(q, part(x, TURN));
                x[0] = x[1] = x[2] = 0.0;
            }
        }
        attitude[j] = q;
    }
    after.weight = by_logs(weight, logs);
    // About the attitude of the most probable mode.
    after.quaternion = attitude[most_probable_mode(after.weight)];
    for (int j = 0; j < MODES; ++j) {
        const Vector3 turn = rotation_between(after.quaternion, attitude[j]);
        for (int i = 0; i < 3; ++i) {
            after.mode[j].mean[TURN + i] = turn[i];
        }
    }
    about_mean(after);
}

template <int MOST>
void update_motion(const MotionMeasurement<MOST> &measured, MotionWith<MOST> &motion) {
    const Weights logs = measured.stars.size == 3 ? correct_modes<3>(measured, motion)
                                                  : correct_modes<6>(measured, motion);
    motion.weight = by_logs(motion.weight, logs);
    motion.frames = std::fmin(motion.frames + 1, MOST_FRAMES);
    const Weights seen = by_experience(motion.weight, motion.share);
    for (int j = 0; j < MODES; ++j) {
        motion.share[j] += (seen[j] - motion.share[j]) / motion.frames;
    }
    about_mean(motion);
}

/// The frequency of a swing: three turns from frame to frame in a row of a body that swings with w,
/// less their mean, have a_k + a_k-2 = 2 cos(w dt) a_k-1. So have their changes, of which the least
/// squares for 2 cos(w dt) are product / energy, with a memory.
template <int MOST>
void measure_motion(int64_t before_ns, const Quaternion &quaternion, const Matrix3 &R,
                    MotionWith<MOST> &motion) {
    Swing &swing = motion.swing;
    const double dt_s = static_cast<double>(motion.stamp_ns - before_ns) * 1e-9;
    for (int axis = 0; axis < 3; ++axis) {
        double &noise = motion.noise_rad2[axis];
        noise = NOISE_MEMORY * noise + (1 - NOISE_MEMORY) * R[axis][axis];
    }
    const bool evenly = std::fabs(dt_s - motion.interval_s) < 0.1 * motion.interval_s;
    motion.interval_s = !evenly && dt_s < motion.interval_s
                            ? dt_s
                            : NOISE_MEMORY * motion.interval_s + (1 - NOISE_MEMORY) * dt_s;
    const Vector3 turn =
        evenly ? rotation_between(swing.last, quaternion) : Vector3{{NAN, NAN, NAN}};
    const Vector3 change = turn - swing.turn;
    double product = 0.0, energy = 0.0;
    for (int axis = 0; axis < 3; ++axis) {
        const double a = change[axis], b = swing.change[axis], c = swing.older[axis];
        // Noise of the attitudes gives b^2 a mean of 6 R, b (a + c) one of -8 R.
        product += b * (a + c) / R[axis][axis] + 8.0;
        energy += b * b / R[axis][axis] - 6.0;
    }
    const bool shows = !std::isnan(product);
    if (shows) {
        swing.product = SWING_MEMORY * swing.product + product;
        swing.energy = SWING_MEMORY * swing.energy + energy;
        swing.w2 = 0.0;
        if (swing.energy > SIGNIFICANT_ENERGY) {
            const double b = std::fmin(larger(swing.product / swing.energy, FASTEST), 2.0);
            swing.w2 = square(std::acos(b / 2) / dt_s);
        }
    }
    if (swing.w2 == 0) {
        swing.weight = 0.0;
    } else if (shows) {
        // turn_k + turn_k-2 - b turn_k-1 = (2 - b) times the mean turn.
        const double b = 2 * std::cos(std::sqrt(swing.w2) * dt_s);
        swing.weight = SWING_MEMORY * swing.weight + 1;
        for (int axis = 0; axis < 3; ++axis) {
            const double mean = swing.turn[axis] + (change[axis] - swing.change[axis]) / (2 - b);
            swing.centre[axis] += (mean / dt_s - swing.centre[axis]) / swing.weight;
        }
    }
    swing.older = swing.change;
    swing.change = change;
    swing.turn = turn;
    swing.last = quaternion;
}

Weights by_experience(const Weights &weight, const Weights &share) {
    const Weights next = least_shares(true);
    Weights seen;
    for (int j = 0; j < MODES; ++j) {
        seen[j] = weight[j] * (share[j] + LEAST_SHARE) / (share[j] + next[j]);
    }
    return normalised(seen);
}

// --- what is published ---

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
/// The frames do not tell its frequency w from 2 pi / dt - w, at which the body turns the other way:
/// rates that differ by 2 pi / dt sqrt(A).
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
/// e e^T of the error is added as makes its Mahalanobis distance m = WRONG_SIGMAS - c: with
/// d^2 = e^T P^-1 e that is 1 / m^2 - 1 / d^2 (Sherman and Morrison, Ann. Math. Stat. 21, 1950), and
/// for every axis as much as an error of the size across needs there.
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
/// What these and those two intervals away have beside it is the sigma.
Course course_of(const Motion &motion, const Vector3 &acceleration_rad_s2) {
    const double dt_s = motion.interval_s;
    const Weights own = by_experience(motion.weight, motion.share);
    ModeState<0> mixed[MODES];
    const Weights next = mix_modes(motion, own, acceleration_rad_s2, least_shares(false), mixed);
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

// --- for a single tracker, and for several heads ---

#define ST_MOTION_OF(MOST)                                                                       \
    template void start_motion(const StateWith<MOST> &, const double *, const Vector3 &, double, \
                               MotionWith<MOST> &);                                              \
    template void restart_motion(const StateWith<MOST> &, MotionWith<MOST> &);                   \
    template void resume_motion(const MotionWith<MOST> &, MotionWith<MOST> &);                   \
    template void interrupt_motion(MotionWith<MOST> &);                                          \
    template StateWith<MOST> state_of(const MotionWith<MOST> &, const Weights &);                \
    template void constants_of(const MotionWith<MOST> &, const Weights &, double *);             \
    template Vector3 acceleration_of(const MotionWith<MOST> &);                                  \
    template void predict_motion(const MotionWith<MOST> &, int64_t, const GyroRates &,           \
                                 const ProcessNoise<MOST> &, MotionWith<MOST> &);                \
    template void update_motion(const MotionMeasurement<MOST> &, MotionWith<MOST> &);            \
    template void measure_motion(int64_t, const Quaternion &, const Matrix3 &,                   \
                                 MotionWith<MOST> &);                                            \
    template Matrix<6, 6> with_tails(const MotionWith<MOST> &, Matrix<6, 6>);

ST_MOTION_OF(0)
ST_MOTION_OF(MOST_CONSTANTS)

}  // namespace st
