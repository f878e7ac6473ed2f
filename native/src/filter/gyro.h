// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Measured body rates with their error model, and the propagation of an attitude by them.
//
// The errors are those of Farrenkopf's model (J. Guid. Control 1, 1978). A measured rate is the
// mean over the interval since the previous measurement and is used over that interval. Where
// there is none the nearest one is used, and the uncertainty grows with the distance in time.

#pragma once

#include <cstdint>

#include "filter/attitude_state.h"
#include "maths/arena.h"
#include "startracker.h"

namespace st {

constexpr int MOST_GYRO_RATES = 4;  // in a frame interval, for the modes of motion

/// The errors of a gyro, of each axis.
struct GyroModel {
    double drift_sigma_rad_s;   // of a drift of which nothing is known
    double drift_density;       // of its random walk, rad^2/s^3
    double noise_density;       // of the white noise of the rate, rad^2/s
    double rate_change_rad_s2;  // of the body between measurements, 1 sigma
    double range_rad_s;         // from which on a measurement is saturated
};

GyroModel gyro_model(const st_gyro_options &options);

/// The mean rate about sensor axes up to a stamp.
struct MeasuredRate {
    int64_t stamp_ns;
    Vector3 rate_rad_s;
};

/// Measured rates between two times, one after another: after dt_s[k] rate k counts, of this
/// variance of each axis without drift; dt_s[count] is the rest up to the end.
struct GyroRates {
    int count;
    double dt_s[MOST_GYRO_RATES + 1];
    Vector3 rate_rad_s[MOST_GYRO_RATES];
    double variance[MOST_GYRO_RATES];
};

/// Return no rates, for an interval that is predicted without a gyro.
inline GyroRates no_rates(double dt_s) {
    return {0, {dt_s}, {}, {}};
}

/// A mean rate and its variance of each axis without drift.
struct MeanRate {
    Vector3 rate_rad_s;
    double variance;
};

/// The latest rates, in a ring: the oldest one is overwritten where it is full.
class Gyro {
public:
    GyroModel model{};

    /// Start without rates, with memory for so many.
    void start(const GyroModel &errors, MeasuredRate *memory, int capacity);

    /// Forget all rates.
    void clear();

    /// Add the rate about sensor axes measured up to a time, in the order of the stamps; false if
    /// it is rejected: not finite, or saturated.
    bool add(int64_t stamp_ns, const Vector3 &rate_rad_s);

    int count() const { return count_; }

    /// Return how long before a time the newest measurement was; infinity without any.
    double silent_s(int64_t stamp_ns) const;

    /// Whether a measurement reached the range at most for_s before a time.
    bool is_saturated(int64_t stamp_ns, double for_s) const;

    /// Whether a measurement of this stamp reached the range, as the newest that did.
    bool was_saturated_at(int64_t stamp_ns) const;

    /// Return the state at a later time, propagated by the measured rates alone.
    template <int MOST>
    StateWith<MOST> propagated(const StateWith<MOST> &state, int64_t to_ns) const;

    /// Return the state at a later time, by the rates alone, and move the one given to the newest
    /// rate: the next prediction starts there, so that rates that come late are used then.
    AttitudeState predicted(AttitudeState &state, int64_t to_ns) const;

    /// Return the measured rates between two times. A mean rate counts at the middle of its
    /// interval; no more than MOST_GYRO_RATES, means of more.
    GyroRates rates(int64_t from_ns, int64_t to_ns) const;

    /// Return the mean rate between two times.
    MeanRate mean_rate(int64_t from_ns, int64_t to_ns) const;

private:
    const MeasuredRate &at(int index) const;
    int first_after(int64_t stamp_ns) const;
    int first_not_before(int64_t stamp_ns) const;
    double mean_s(int index) const;

    MeasuredRate *ring_ = nullptr;
    int capacity_ = 0, oldest_ = 0, count_ = 0;
    bool has_saturated_ = false;
    int64_t saturated_ns_ = 0;
};

}  // namespace st
