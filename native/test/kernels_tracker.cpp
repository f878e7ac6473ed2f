// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "kernels_tracker.h"

#include "sky/epoch.h"
#include "tracker.h"

using namespace st;

namespace {

/// Return the motion of a tracker, to be changed.
Motion &motion_of(st_tracker *tracker) {
    return const_cast<Motion &>(tracker->tracking->filter.model().motion());
}

}  // namespace

extern "C" {

void stt_set_motion(st_tracker *tracker, const double quaternion[4], const double rate[3],
                    double variance) {
    Motion &motion = motion_of(tracker);
    AttitudeState state{};
    state.stamp_ns = motion.stamp_ns;
    state.quaternion = {quaternion[0], quaternion[1], quaternion[2], quaternion[3]};
    state.rate_rad_s = {{rate[0], rate[1], rate[2]}};
    for (int i = 0; i < STATE_SIZE; ++i) {
        state.covariance[i][i] = variance;
    }
    const double interval_s = motion.interval_s;
    start_motion(state, nullptr, {{variance, variance, variance}}, interval_s, motion);
    for (ModeState<0> &mode : motion.mode) {
        for (int axis = ACCELERATION; axis < DRIFT; ++axis) {
            mode.covariance[axis][axis] = 0.0;
        }
    }
}

void stt_set_variance(st_tracker *tracker, int32_t element, double variance) {
    for (ModeState<0> &mode : motion_of(tracker).mode) {
        mode.covariance[element][element] = variance;
    }
}

void stt_earth_position_au(double year, double position[3]) {
    const Vector3 found = earth_position_au(year);
    for (int axis = 0; axis < 3; ++axis) {
        position[axis] = found[axis];
    }
}

}  // extern "C"
