// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// What a model of the motion of stars starts with: two identified frames, or one and a hint.

#pragma once

#include "maths/arena.h"
#include "sky/apparent.h"
#include "track/rotation_fit.h"

namespace st {

/// A frame that fits the catalogue: stars with their centroids, and the attitude.
///
/// scale is that of RotationFit.
struct IdentifiedFrame {
    int64_t stamp_ns;
    Quaternion quaternion;
    Matrix3 covariance;
    double scale;
    List<int32_t> star;
    List<st_centroid> centroid;  // as many as stars
};

/// Return the bytes that frame_for() takes.
size_t identified_frame_bytes(int capacity);

/// Return a frame without stars.
IdentifiedFrame frame_for(int capacity, Arena &arena);

/// Copy a frame into one of at least its capacity.
void copy_frame(const IdentifiedFrame &from, IdentifiedFrame &to);

/// Return the bytes of work memory of fit_identified().
size_t fit_identified_bytes(int count);

/// Fit an identified frame without outliers; false unless enough stars fit well enough: reason is
/// then why they do not, ST_NO_REASON where they are too few.
///
/// hip (count) is of each centroid, 0 where it is unknown. Crowded stars are left out. Of several
/// centroids with one hip the first, the brightest, counts.
bool fit_identified(const Lens &lens, const ApparentSky &sky, const st_tracking_options &options,
                    int64_t stamp_ns, const st_centroid *centroids, const int32_t *hip, int count,
                    IdentifiedFrame &frame, st_reason &reason, Arena &work);

/// Whether a tracked attitude of the same frame is too far from an identified one, in sigma and in
/// pixels: a small sigma alone, or a poor lens alone, is not a contradiction.
bool contradicts(const IdentifiedFrame &frame, const Quaternion &tracked,
                 const Matrix3 &tracked_covariance, const Lens &lens, const ApparentSky &sky,
                 double max_residual_px);

/// The attitude, of an identified frame, and body rate that tracks start with.
///
/// cross is the covariance of attitude and rate error; hinted is whether the rate is that of a hint.
struct Start {
    const IdentifiedFrame *frame;
    Vector3 rate_rad_s;
    Matrix3 rate_covariance, cross;
    st_reason reason;
    bool hinted;
};

/// Return the start at the second of two frames.
Start start_of_two(const IdentifiedFrame &first, const IdentifiedFrame &second);

/// Fill in the start at a frame of stars where tracks predicted them; false if they differ.
bool start_of_prediction(const st_hint &predicted, const IdentifiedFrame &frame, Start &start);

/// Starts by the newest hint, where an identified frame confirms it.
///
/// The stars alone give the attitude. A false hint changes nothing but the rate, and where the stars
/// are lost by that, hints are ignored until a start without one.
struct HintedStart {
    st_hint newest;
    bool is_there, ignored, used;
};

void add_hint(const st_hint &hint, HintedStart &hints);

/// Fill in the start at a frame that agrees with the hint; false without one.
bool start_of_hint(const HintedStart &hints, const IdentifiedFrame &frame, double max_gap_s,
                   Start &start);

/// Note what the tracker has started with.
void note_start(bool hinted, HintedStart &hints);

/// Note that the tracker has lost the stars after so many good frames.
void note_loss(int good_frames, HintedStart &hints);

}  // namespace st
