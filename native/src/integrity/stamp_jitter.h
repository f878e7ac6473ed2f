// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Errors of stamps, estimated from the frames of a body that turns.
//
// A stamp that is late by d shows the body where it is not yet: a turn w d along its rate w, the same
// for all stars. Frames stamped on arrival have timestamp errors of milliseconds, each its own.
// Neither residuals nor a smooth rate show that, but the attitudes a measured by the stars do.
// With the second differences
//
//     e_k = (a_k - a_k-1) - (a_k-1 - a_k-2) dt_k / dt_k-1
//
// and R the covariance of a, t_k = w^T R^-1 e_k / (w^T R^-1 w) is the best estimate of their part
// along the rate as a time, and the mean of t_k t_k-1 is -4 (r + s^2), r = 1 / (w^T R^-1 w), s the
// standard deviation of the stamps. Changes of the rate make it zero or positive, so no manoeuvre is
// mistaken for an error of the stamps. Times weigh by 1 / r: of a swinging body at its turning points
// they say nothing.
//
// A vibration moves the body to and fro as well. But where the filter predicts the next frame, it is
// not an error of a stamp. A camera that is shaken at random moves across its rate as much as
// along it: with the part u_k of e_k that is across, as a time, s^2 is less by what -u_k u_k-1 / 4
// is more than r.
//
// In the first frames the timestamp errors are up to first_s of STAMP_ERRORS: no more than the
// size of the few products so far allows, whatever their signs. From STAMP_ERRORS.frames on only
// what that size shows counts, and their signs decide alone after twice as many. Stamps that had
// errors so far may go on to do so: less is significant then, and what is known fades slowly.

#pragma once

#include <cstdint>

#include "maths/rotation.h"

namespace st {

constexpr int COMPARED_FRAMES = 20;    // whose times are compared
constexpr int RECENT_PREDICTIONS = 8;  // frames of whose predictions the errors are known

/// Attitude and rate of the filter at a time.
struct AttitudeAt {
    int64_t stamp_ns;
    Quaternion quaternion;  // q_icrf_from_sensor
    Vector3 rate_rad_s;
};

/// Times of the newest frames, NaN in front of the first one, as of the equations above.
struct Differences {
    Vector3 left;  // correction minus measured turn of the last frame, with the sign reversed
    Vector3 step;  // measured turn between the last two
    double times_s[COMPARED_FRAMES], variances_s2[COMPARED_FRAMES];  // t_k, r
    double across_s[2][COMPARED_FRAMES];                             // u_k
};

/// The standard deviation of the stamps, and what it turns the body by, about sensor axes; both are
/// zero where they are not significant. start_jitter() makes one.
struct StampJitter {
    double sigma_s;
    Vector3 turn_rad;

    Vector3 rate_rad_s;  // mean of the frames before, not normalised
    int frames;
    double interval_s;  // of the last two frames, NaN where the next one has no neighbour
    Differences differences;
    struct {
        double excess, speed2;
    } recent[RECENT_PREDICTIONS];  // oldest first
    int recents;
};

/// Return what is known before the first frame.
StampJitter start_jitter();

/// Begin new differences: the frames before are not neighbours of the next one.
void interrupt_jitter(StampJitter &jitter);

/// Add a good frame: the state of the frame before, the prediction, and the corrected one. turn from
/// the prediction is what the stars measure, of covariance R.
void add_frame(const AttitudeAt &before, const AttitudeAt &predicted, const AttitudeAt &corrected,
               const Vector3 &turn, const Matrix3 &R, StampJitter &jitter);

}  // namespace st
