// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// How the body moves from one frame to the next: by its modes of motion, the gyro, or both.

#pragma once

#include "filter/gyro.h"
#include "fusion/fused_state.h"
#include "integrity/gyro_agreement.h"
#include "startracker_fusion.h"

namespace st {

/// Propagates states; uses the gyro once it has agreed with the rate of the heads.
class BodyMotion {
public:
    bool uses_gyro;
    st_reason gyro_trouble;  // why the rates of a gyro are not used

    /// Start without rates; walk are the spectral densities of the coefficients, rad^2/s.
    void start(const st_fusion_config &config, const double *walk, int coefficients,
               MeasuredRate *memory, int rates);

    /// Forget the rates.
    void reset();

    /// Use the gyro only after it has agreed with the heads again.
    void forget_gyro();

    /// Let the gyro agree for longer, with the heads that have compared it, before it is used
    /// again.
    void contradict_gyro(const st_reason &trouble);

    /// 1-sigma error of a drift of which nothing is known.
    double drift_sigma_rad_s() const { return gyro_.model.drift_sigma_rad_s; }

    /// Add a rate about body axes; false if it is rejected or not newer than the last. A jump of
    /// time back by more than a second is another gyro.
    bool add_rate(int64_t stamp_ns, const Vector3 &rate_rad_s);

    /// Whether the rates propagate a state to a time.
    bool gyro_runs(int64_t stamp_ns) const;

    /// Whether the rates end so long before a time that they predict nothing sharp: a state
    /// predicted so would take any frame of that time for right.
    bool extrapolates(int64_t stamp_ns) const;

    /// Return the longest time without frames before a time.
    double bridged_s(int64_t stamp_ns) const;

    /// Fill motion and state at a later time, by what the body has been seen to do. A motion that
    /// begins is not expected: it is what frames that disagree are checked for.
    void propagate(const BodyMotionState &before, int64_t to_ns, BodyMotionState &motion,
                   FusedState &state) const;

    /// The same without the gyro.
    void propagate_without_gyro(const BodyMotionState &before, int64_t to_ns,
                                BodyMotionState &motion, FusedState &state) const;

    /// The same at a constant rate, with a factor of the acceleration of the options.
    void propagate_at_constant_rate(const BodyMotionState &before, int64_t to_ns, double factor,
                                    BodyMotionState &motion, FusedState &state) const;

    /// Compare the gyro with the heads after a frame of a head, which measures the body. Return
    /// whether it is used no more: the rate of the state after is a wrong one then.
    bool compare_gyro(int head, int64_t before_ns, const BodyState &after,
                      const HeadMeasurement &measured);

private:
    void clear_gyro();
    bool is_behind(int64_t stamp_ns) const;
    void predict(const BodyMotionState &before, int64_t to_ns, double factor,
                 const GyroRates &rates, BodyMotionState &motion) const;

    st_fusion_options options_;
    double rate_change_rad_s2_;
    Gyro gyro_;
    Vector<3 + MOST_CONSTANTS> walk_;
    GyroAgreement agreement_[ST_MOST_HEADS];
    bool has_compared_[ST_MOST_HEADS];
};

}  // namespace st
