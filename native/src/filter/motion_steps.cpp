// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// A frame: prediction, update by the stars, and what it shows of noise and swings.

#include <cmath>

#include "filter/modes.h"
#include "filter/motion.h"
#include "maths/symmetric.h"

namespace st {

namespace {

constexpr double MOST_JUMPS = 20.0;    // that the spread of jumps is the mean of
constexpr double MOST_FRAMES = 200.0;  // that the shares are the means of
constexpr double SWING_MEMORY = 0.93;  // of the sums of the fit of w
constexpr double FASTEST = -1.0;       // 2 cos(w dt): three frames in a period
// Energy of a swing over the variance of the noise; that of noise: 55.
constexpr double SIGNIFICANT_ENERGY = 200.0;

double square(double x) {
    return x * x;
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
    double cross[CONSTANT + MOST][3]{}, gain[CONSTANT + MOST][3];
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
/// (the information filter, without an inverse of Y, which may be singular). Columns of L from
/// last on are zero, as those before first.
template <int SIZE, int MOST>
double correct_by_stars(const Matrix<SIZE, SIZE> &Y, const Vector<SIZE> &vector,
                        const Vector<SIZE> &base, const double *const *L, int first, int last,
                        ModeState<MOST> &mode, int n) {
    auto &x = mode.mean;
    auto &P = mode.covariance;
    double columns[CONSTANT + MOST][SIZE]{}, rows[CONSTANT + MOST][SIZE];
    for (int i = 0; i < n; ++i) {
        for (int k = 0; k < SIZE; ++k) {
            columns[i][k] = P[i][k];
            for (int j = first; j < last; ++j) {
                // 0 <= first <= last <= 3. NOLINTNEXTLINE(clang-analyzer-security.ArrayBound)
                columns[i][k] += P[i][ACCELERATION + j] * L[k][j];
            }
        }
    }
    Matrix<SIZE, SIZE> S;
    Vector<SIZE> away;
    for (int i = 0; i < SIZE; ++i) {
        double predicted = x[i];
        for (int j = first; j < last; ++j) {
            // NOLINTNEXTLINE(clang-analyzer-security.ArrayBound): as above
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
    double det = 0.0;
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

}  // namespace

template <int MOST>
void predict_motion(const MotionWith<MOST> &before, int64_t to_ns, const GyroRates &rates,
                    const ProcessNoise<MOST> &noise, MotionWith<MOST> &after) {
    const int n = before.size();
    const Swing &swing = before.swing;
    static_cast<MotionSummary<MOST> &>(after) = before;
    after.stamp_ns = to_ns;
    const Weights weight =
        mix_modes(before, before.weight, noise.acceleration_rad_s2, true, after.mode);
    Weights logs{};
    Quaternion attitude[MODES];
    for (int j = 0; j < MODES; ++j) {
        attitude[j] = before.quaternion;
        if (weight[j] == 0) {
            logs[j] = -HUGE_VAL;
            continue;
        }
        const Mode &mode = MODE[j];
        const Vector3 noise_rad2 = noise_of(mode, before.noise_rad2, before.jumps);
        double *x = after.mode[j].mean.element;
        auto &P = after.mode[j].covariance;
        Quaternion q = turned(before.quaternion, part(x, TURN));
        for (int k = 0; k <= rates.count; ++k) {
            const double dt_s = rates.dt_s[k];
            const Quaternion turn =
                quaternion_from_rotation_vector(turn_of(x, mode.kind, dt_s, swing));
            const Transition step = transition_of(mode, dt_s, swing.w2, noise_rad2,
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
    const Quaternion predicted = motion.quaternion;
    about_mean(motion);
    const double sudden = total_weight(motion.weight, SUDDEN);
    const Vector3 moved = rotation_between(predicted, motion.quaternion);
    motion.seen_jumps = std::fmin(motion.seen_jumps + sudden, MOST_JUMPS);
    for (int axis = 0; axis < 3; ++axis) {
        motion.jumps[axis] += sudden / motion.seen_jumps *
                              (square(moved[axis]) / motion.noise_rad2[axis] - motion.jumps[axis]);
    }
}

/// The frequency of a swing: three turns from frame to frame in a row of a body that swings with
/// w, less their mean, have a_k + a_k-2 = 2 cos(w dt) a_k-1. So have their changes, of which the
/// least squares for 2 cos(w dt) are product / energy, with a memory.
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

// --- for a single tracker, and for several heads ---

#define ST_MOTION_OF(MOST)                                                             \
    template void predict_motion(const MotionWith<MOST> &, int64_t, const GyroRates &, \
                                 const ProcessNoise<MOST> &, MotionWith<MOST> &);      \
    template void update_motion(const MotionMeasurement<MOST> &, MotionWith<MOST> &);  \
    template void measure_motion(int64_t, const Quaternion &, const Matrix3 &, MotionWith<MOST> &);

ST_MOTION_OF(0)
ST_MOTION_OF(MOST_CONSTANTS)

}  // namespace st
