// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "filter/gyro.h"

#include <cmath>

#include "filter/motion.h"

namespace st {

namespace {

constexpr double RAD = M_PI / 180, HOUR_S = 3600.0;
constexpr double SATURATED = 0.999;  // of the range

double square(double x) {
    return x * x;
}

double seconds(int64_t ns) {
    return static_cast<double>(ns) * 1e-9;
}

int64_t distance_ns(int64_t a, int64_t b) {
    return a > b ? a - b : b - a;
}

/// Propagate a covariance by a rate that turns the axes by A^T for dt_s, its error -drift error:
///
///     P <- Phi P Phi^T,  Phi = [A 0 -dt I; 0 0 -I; 0 0 I]
///
/// of turn, rate and drift (Lefferts, Markley and Shuster 1982, section IX).
template <int N>
void carry_by_gyro(Matrix<N, N> &P, int size, const Matrix3 &A, double dt_s) {
    for (int k = 0; k < size; ++k) {
        const double x = P[0][k], y = P[1][k], z = P[2][k];
        for (int i = 0; i < 3; ++i) {
            P[i][k] = A[i][0] * x + A[i][1] * y + A[i][2] * z - dt_s * P[6 + i][k];
            P[3 + i][k] = -P[6 + i][k];
        }
    }
    for (int k = 0; k < size; ++k) {
        const double x = P[k][0], y = P[k][1], z = P[k][2];
        for (int i = 0; i < 3; ++i) {
            P[k][i] = A[i][0] * x + A[i][1] * y + A[i][2] * z - dt_s * P[k][6 + i];
            P[k][3 + i] = -P[k][6 + i];
        }
    }
}

}  // namespace

GyroModel gyro_model(const st_gyro_options &options) {
    const double drift = options.gyro_drift_deg_h * RAD / HOUR_S;
    return {drift, drift * drift / HOUR_S,
            // deg/sqrt(h) is deg/60 in a root of a second.
            square(options.gyro_noise_deg_sqrt_h * RAD / 60),
            options.gyro_rate_change_deg_s2 * RAD, SATURATED * options.gyro_range_deg_s * RAD};
}

void Gyro::start(const GyroModel &errors, MeasuredRate *memory, int capacity) {
    model = errors;
    ring_ = memory;
    capacity_ = capacity;
    clear();
}

void Gyro::clear() {
    oldest_ = count_ = 0;
    has_saturated_ = false;
}

bool Gyro::add(int64_t stamp_ns, const Vector3 &rate_rad_s) {
    double largest = 0.0;
    for (double rate : rate_rad_s.element) {
        if (!std::isfinite(rate)) {
            return false;
        }
        largest = std::fmax(largest, std::fabs(rate));
    }
    if (largest >= model.range_rad_s) {
        has_saturated_ = true;
        saturated_ns_ = stamp_ns;
        return false;
    }
    if (capacity_ == 0) {
        return false;
    }
    ring_[(oldest_ + count_) % capacity_] = {stamp_ns, rate_rad_s};
    if (count_ < capacity_) {
        ++count_;
    } else {
        oldest_ = (oldest_ + 1) % capacity_;
    }
    return true;
}

const MeasuredRate &Gyro::at(int index) const {
    return ring_[(oldest_ + index) % capacity_];
}

int Gyro::first_after(int64_t stamp_ns) const {
    int low = 0, high = count_;
    while (low < high) {
        const int middle = (low + high) / 2;
        if (at(middle).stamp_ns > stamp_ns) {
            high = middle;
        } else {
            low = middle + 1;
        }
    }
    return low;
}

int Gyro::first_not_before(int64_t stamp_ns) const {
    return stamp_ns == INT64_MIN ? 0 : first_after(stamp_ns - 1);
}

double Gyro::silent_s(int64_t stamp_ns) const {
    return count_ == 0 ? INFINITY : seconds(stamp_ns - at(count_ - 1).stamp_ns);
}

bool Gyro::is_saturated(int64_t stamp_ns, double for_s) const {
    const int64_t since_ns = stamp_ns - saturated_ns_;
    return has_saturated_ && since_ns >= 0 && static_cast<double>(since_ns) <= for_s * 1e9;
}

bool Gyro::was_saturated_at(int64_t stamp_ns) const {
    return has_saturated_ && saturated_ns_ == stamp_ns;
}

/// Return the time that a rate is the mean of, infinity where nothing shows it.
double Gyro::mean_s(int index) const {
    const int64_t stamp_ns = at(index).stamp_ns;
    const int before = first_not_before(stamp_ns) - 1;
    if (before >= 0) {
        return seconds(stamp_ns - at(before).stamp_ns);
    }
    const int after = first_after(stamp_ns);
    return after < count_ ? seconds(at(after).stamp_ns - stamp_ns) : INFINITY;
}

template <int MOST>
StateWith<MOST> Gyro::propagated(const StateWith<MOST> &state, int64_t to_ns) const {
    StateWith<MOST> after = state;
    if (count_ == 0 || to_ns <= state.stamp_ns) {
        return after;
    }
    auto &P = after.covariance;
    int64_t from_ns = state.stamp_ns;
    for (int index = first_after(from_ns); from_ns < to_ns; ++index) {
        const int used = index < count_ ? index : count_ - 1;
        const MeasuredRate &measured = at(used);
        const int64_t until_ns =
            used < index || measured.stamp_ns > to_ns ? to_ns : measured.stamp_ns;
        if (until_ns <= from_ns) {
            continue;  // two rates of one stamp
        }
        const double dt_s = seconds(until_ns - from_ns);
        after.rate_rad_s = measured.rate_rad_s - after.drift_rad_s;
        const Quaternion turn = quaternion_from_rotation_vector(scaled(after.rate_rad_s, dt_s));
        after.quaternion = normalised(multiply(after.quaternion, turn));
        carry_by_gyro(P, after.size(), transposed(matrix_from_quaternion(turn)), dt_s);
        // A short mean that is used for long has more noise, and a rate measured at another time
        // may have changed since.
        const double density = model.noise_density * std::fmax(1.0, dt_s / mean_s(used));
        const int64_t from = distance_ns(measured.stamp_ns, from_ns);
        const int64_t until = distance_ns(measured.stamp_ns, until_ns);
        const double away_s = seconds(from > until ? from : until);
        const double variance = square(model.rate_change_rad_s2 * away_s * dt_s);
        for (int axis = 0; axis < 3; ++axis) {
            P[axis][axis] += density * dt_s + variance;
            P[axis][3 + axis] += density;
            P[3 + axis][axis] += density;
            P[3 + axis][3 + axis] += density / dt_s;
            P[6 + axis][6 + axis] += model.drift_density * dt_s;
        }
        from_ns = until_ns;
    }
    after.stamp_ns = to_ns;
    return after;
}

template StateWith<0> Gyro::propagated(const StateWith<0> &, int64_t) const;
template StateWith<MOST_CONSTANTS> Gyro::propagated(const StateWith<MOST_CONSTANTS> &,
                                                    int64_t) const;

AttitudeState Gyro::predicted(AttitudeState &state, int64_t to_ns) const {
    if (count_ > 0) {
        const int64_t newest_ns = at(count_ - 1).stamp_ns;
        state = propagated(state, newest_ns < to_ns ? newest_ns : to_ns);
    }
    return propagated(state, to_ns);
}

GyroRates Gyro::rates(int64_t from_ns, int64_t to_ns) const {
    GyroRates rates{};
    const int after_from = first_after(from_ns), begin = after_from > 1 ? after_from : 1;
    const int end = first_after(to_ns), found = end > begin ? end - begin : 0;
    const int every =
        found > MOST_GYRO_RATES ? (found + MOST_GYRO_RATES - 1) / MOST_GYRO_RATES : 1;
    int64_t last_ns = from_ns;
    for (int group = begin; group < end; group += every) {
        const int after = group + every < end ? group + every : end;
        const int64_t first_ns = at(group - 1).stamp_ns, newest_ns = at(after - 1).stamp_ns;
        if (newest_ns <= first_ns) {
            continue;
        }
        Vector3 turn{};
        double whole_s = 0.0;
        for (int k = group; k < after; ++k) {
            const double dt_s = seconds(at(k).stamp_ns - at(k - 1).stamp_ns);
            turn = turn + scaled(at(k).rate_rad_s, dt_s);
            whole_s += dt_s;
        }
        const int64_t middle_ns = first_ns + (newest_ns - first_ns) / 2;
        const int64_t counts_ns = middle_ns > last_ns ? middle_ns : last_ns;
        rates.dt_s[rates.count] = seconds(counts_ns - last_ns);
        for (int axis = 0; axis < 3; ++axis) {
            rates.rate_rad_s[rates.count][axis] = turn[axis] / whole_s;
        }
        rates.variance[rates.count] = model.noise_density / whole_s;
        ++rates.count;
        last_ns = counts_ns;
    }
    rates.dt_s[rates.count] = seconds(to_ns - last_ns);
    return rates;
}

MeanRate Gyro::mean_rate(int64_t from_ns, int64_t to_ns) const {
    if (count_ == 0) {
        return {{{NAN, NAN, NAN}}, INFINITY};
    }
    // The interval of the first measurement at or after the end contains the end.
    const int after_to = first_not_before(to_ns) + 1, last = after_to < count_ ? after_to : count_;
    const int after_from = first_after(from_ns), first = after_from < last ? after_from : last - 1;
    const double dt_s = seconds(to_ns - from_ns);
    Vector3 sum{};
    double measured_s = 0.0;
    for (int index = first; index < last; ++index) {
        sum = sum + at(index).rate_rad_s;
        measured_s += mean_s(index);
    }
    return {scaled(sum, 1.0 / (last - first)), model.noise_density / std::fmin(dt_s, measured_s) +
                                                   square(model.rate_change_rad_s2 * dt_s)};
}

}  // namespace st
