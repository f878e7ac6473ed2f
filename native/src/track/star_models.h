// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The papers' models of stars: a filter of position and velocity on the image for each (constant
// velocity, coordinated turn; Sadeghi, Sabahi and Saberali), or none, each star where it was measured
// (SNA; Samaan, Mortari and Junkins).
//
//     make_star_model(options, lens, arena, model);       once, without tracks
//     start_stars(start, roll, options, model);           at an identified frame
//     add_star(...);                                      a track of each of its stars
//     update_stars(stamp_ns, centroids, ...);             every frame

#pragma once

#include "track/bank.h"
#include "track/jpdaf.h"
#include "track/rotation_fit.h"
#include "track/start.h"

namespace st {

/// The mean body rate about the boresight by a gyro, from the frame before to this one: there with
/// the option roll_by_gyro and a gyro that is not silent. noise_density rad^2/s is that of its white
/// noise.
struct MeasuredRoll {
    bool is_there;
    double rate_rad_s, noise_density;
};

/// The tracks, and how the camera turns. kind is not ST_ATTITUDE_MODEL; roll is the measured one that
/// the velocities contain, gyro_trouble why such rolls are not used; fitted is the last good attitude.
struct StarModel {
    st_motion_model kind;
    Lens lens;
    DetectionModel detection;
    TrackList bank;
    int64_t stamp_ns, fitted_ns;
    Quaternion fitted;
    Matrix3 fitted_covariance;
    Vector3 rate_rad_s;
    Matrix3 rate_covariance;
    MeasuredRoll roll;
    bool uses_gyro;
    st_reason gyro_trouble;
};

/// What a frame of centroids did: good when enough stars agree on an attitude within the limits.
/// fit has a row for each track of the bank and is there where has_fit; uv (centroids) are where the
/// centroids were at the time of the frame, unassociated (centroids) those in no gate.
struct StarUpdate {
    bool good, has_fit;
    RotationFit fit;
    const Point *uv;
    const bool *unassociated;
    int pairings_left_out, states_left_out;
};

/// Return the bytes that make_star_model() takes.
size_t star_model_bytes(const st_tracking_options &options);

/// Return the bytes that update_stars() takes: what stays in the update, and work.
size_t star_update_bytes(const st_tracking_options &options, int centroids);
size_t star_update_work_bytes(const st_tracking_options &options, int centroids);

/// Make a model without tracks.
void make_star_model(const st_tracking_options &options, const Lens &lens, Arena &arena,
                     StarModel &model);

/// Begin at an identified frame with its rate, without tracks; roll is that up to its stamp.
void start_stars(const Start &start, const MeasuredRoll &roll, StarModel &model);

/// Add the track of a star at a centroid, which moves with the body rate; false without a place.
bool add_star(uint32_t track_id, int32_t star, const st_centroid &centroid, bool confirmed,
              const st_tracking_options &options, StarModel &model);

/// Predict the tracks to the time of a newer frame, and update them by it. The lists of update are
/// in memory.
void update_stars(int64_t stamp_ns, const st_centroid *centroids, int count,
                  const MeasuredRoll &roll, const ApparentSky &sky,
                  const st_tracking_options &options, StarModel &model, StarUpdate &update,
                  Arena &memory, Arena &work);

/// Predict the tracks to a time; stars that leave the image are dropped.
void predict_tracks(int64_t stamp_ns, const MeasuredRoll &roll, const st_tracking_options &options,
                    StarModel &model, Arena &work);

}  // namespace st
