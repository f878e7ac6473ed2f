// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "fusion/body_motion.h"

#include <cmath>

#include "fusion/head.h"
#include "integrity/checks.h"
#include "maths/symmetric.h"

namespace st {

namespace {

constexpr int GYRO_FRAMES = 3;  // with whose rate a gyro has to agree before it is used
constexpr double GYRO_SILENCE_S = limit(checks::GYRO_SILENT, "age_s");
constexpr double ACCELERATION_S = 0.1;
constexpr double SHARP_TURN_RAD = 5 * ARCSEC;  // 1 sigma, beyond the newest rate

double seconds(int64_t ns) {
    return static_cast<double>(ns) * 1e-9;
}

}  // namespace

void BodyMotion::start(const st_fusion_config &config, const double *walk, int coefficients,
                       MeasuredRate *memory, int rates) {
    options_ = config.fusion;
    rate_change_rad_s2_ = config.gyro.gyro_rate_change_deg_s2 * M_PI / 180;
    gyro_.start(gyro_model(config.gyro), memory, rates);
    walk_ = {};
    for (int k = 0; k < 3; ++k) {
        walk_[k] = gyro_.model.drift_density;
    }
    for (int k = 0; k < coefficients; ++k) {
        walk_[3 + k] = walk[k];
    }
    reset();
}

void BodyMotion::reset() {
    gyro_trouble = {};
    clear_gyro();
}

/// Start with a gyro of which nothing is known.
void BodyMotion::clear_gyro() {
    gyro_.clear();
    uses_gyro = false;
    for (int k = 0; k < ST_MOST_HEADS; ++k) {
        agreement_[k] = {};
        has_compared_[k] = false;
    }
}

void BodyMotion::forget_gyro() {
    uses_gyro = false;
    for (GyroAgreement &one : agreement_) {
        interrupt_agreement(one);
    }
}

void BodyMotion::contradict_gyro(const st_reason &trouble) {
    gyro_trouble = trouble;
    for (int k = 0; k < ST_MOST_HEADS; ++k) {
        if (has_compared_[k]) {
            contradict_agreement(agreement_[k]);
        }
    }
}

bool BodyMotion::add_rate(int64_t stamp_ns, const Vector3 &rate_rad_s) {
    const double silent_s = gyro_.silent_s(stamp_ns);
    if (silent_s <= 0) {
        if (silent_s > -GYRO_SILENCE_S) {
            return false;
        }
        clear_gyro();
    }
    const bool added = gyro_.add(stamp_ns, rate_rad_s);
    if (gyro_.was_saturated_at(stamp_ns)) {
        forget_gyro();
        gyro_trouble = reason_of(checks::GYRO_AT_RANGE, {});
    }
    return added;
}

bool BodyMotion::gyro_runs(int64_t stamp_ns) const {
    const double ahead_s = options_.horizon_s + GYRO_SILENCE_S;
    const double silent_s = gyro_.silent_s(stamp_ns);
    return uses_gyro && -ahead_s <= silent_s && silent_s <= GYRO_SILENCE_S;
}

bool BodyMotion::extrapolates(int64_t stamp_ns) const {
    return gyro_runs(stamp_ns) && is_behind(stamp_ns);
}

bool BodyMotion::is_behind(int64_t stamp_ns) const {
    const double silent_s = std::fmax(0.0, gyro_.silent_s(stamp_ns));
    return rate_change_rad_s2_ * silent_s * silent_s > SHARP_TURN_RAD;
}

double BodyMotion::bridged_s(int64_t stamp_ns) const {
    return gyro_runs(stamp_ns) ? options_.max_gyro_gap_s : options_.max_gap_s;
}

void BodyMotion::predict(const BodyMotionState &before, int64_t to_ns, double factor,
                         const GyroRates &rates, BodyMotionState &motion) const {
    // As large in its effect as one that lasts for ACCELERATION_S.
    const double acceleration = factor * (options_.acceleration_deg_s2 * M_PI / 180) *
                                std::sqrt(ACCELERATION_S / before.interval_s);
    predict_motion(before, to_ns, rates, {{{acceleration, acceleration, acceleration}}, walk_},
                   motion);
}

void BodyMotion::propagate(const BodyMotionState &before, int64_t to_ns, BodyMotionState &motion,
                           FusedState &state) const {
    if (!gyro_runs(to_ns)) {
        propagate_without_gyro(before, to_ns, motion, state);
        return;
    }
    const double dt_s = seconds(to_ns - before.stamp_ns);
    if (dt_s <= options_.max_gap_s) {
        predict(before, to_ns, 1.0, gyro_.rates(before.stamp_ns, to_ns), motion);
        if (motion.weight[most_probable_mode(before.weight)] > checks::MOTION_ENDS.probability) {
            fuse(motion, by_experience(motion.weight, motion.share), state);
            return;
        }
    }
    // Of another motion than before the modes know less than the gyro, which integrates it.
    BodyState body = gyro_.propagated(state_of(before), to_ns);
    for (int k = 0; k < body.constants.count; ++k) {
        body.covariance[STATE_SIZE + k][STATE_SIZE + k] += walk_[3 + k] * dt_s;
    }
    motion = before;
    restart_motion(body, motion);
    fuse(motion, by_experience(motion.weight, motion.share), state);
}

void BodyMotion::propagate_without_gyro(const BodyMotionState &before, int64_t to_ns,
                                        BodyMotionState &motion, FusedState &state) const {
    predict(before, to_ns, 1.0, no_rates(seconds(to_ns - before.stamp_ns)), motion);
    fuse(motion, by_experience(motion.weight, motion.share), state);
}

void BodyMotion::propagate_at_constant_rate(const BodyMotionState &before, int64_t to_ns,
                                            double factor, BodyMotionState &motion,
                                            FusedState &state) const {
    predict(before, to_ns, factor, no_rates(seconds(to_ns - before.stamp_ns)), motion);
    fuse(motion, weights_of(motion.weight, ONLY_STEADY), state);
}

bool BodyMotion::compare_gyro(int head, int64_t before_ns, const BodyState &after,
                              const HeadMeasurement &measured) {
    GyroAgreement &agreement = agreement_[head];
    has_compared_[head] = true;
    const int64_t stamp_ns = after.stamp_ns;
    if (stamp_ns <= before_ns) {
        return false;
    }
    if (!(std::fabs(gyro_.silent_s(stamp_ns)) <= GYRO_SILENCE_S) ||
        gyro_.is_saturated(stamp_ns, GYRO_SILENCE_S)) {
        interrupt_agreement(agreement);
        return false;
    }
    if (is_behind(stamp_ns)) {
        interrupt_agreement(agreement);
        if (!uses_gyro) {
            gyro_trouble = reason_of(ST_FUSION_GYRO_BEHIND, {gyro_.silent_s(stamp_ns)});
        }
        return false;
    }
    const bool contradicts = add_frame(gyro_,
                                       {stamp_ns, measured.quaternion, measured.covariance,
                                        after.drift_rad_s, block<3, 3>(after.covariance, 6, 6)},
                                       agreement);
    if (uses_gyro && !contradicts) {
        return false;
    }
    const auto [rate, variance] = gyro_.mean_rate(before_ns, stamp_ns);
    if (contradicts) {
        contradict_gyro(reason_of(ST_FUSION_GYRO_TURNS,
                                  {rate[0], rate[1], rate[2], static_cast<double>(head)}));
    }
    if (uses_gyro) {
        uses_gyro = false;
        return true;
    }
    const Vector3 innovation = rate - after.rate_rad_s;
    Matrix3 S = block<3, 3>(after.covariance, 3, 3);
    for (int axis = 0; axis < 3; ++axis) {
        S[axis][axis] += variance + drift_sigma_rad_s() * drift_sigma_rad_s();
    }
    if (dot(innovation, inverse(S) * innovation) > checks::HEAD_DIFFERS.threshold) {
        forget_gyro();
        const Vector3 &own = after.rate_rad_s;
        gyro_trouble =
            reason_of(ST_FUSION_GYRO_RATE, {rate[0], rate[1], rate[2], own[0], own[1], own[2]});
    } else if (is_enough(agreement, GYRO_FRAMES)) {
        uses_gyro = true;
        gyro_trouble = {};
    }
    return false;
}

}  // namespace st
