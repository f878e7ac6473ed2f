// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The papers' models of stars: a filter for each (constant velocity, coordinated turn; Sadeghi,
// Sabahi and Saberali), or none, each star where it was measured (SNA; Samaan, Mortari and
// Junkins).

#pragma once

#include "track/bank.h"
#include "track/jpdaf.h"
#include "track/rotation_fit.h"
#include "track/start.h"

namespace st {

enum class StarMotionModel { CONSTANT_VELOCITY, COORDINATED_TURN, NEIGHBOURHOOD };

struct StarModelOptions {
    StarMotionModel model;
    FalseCentroids false_centroids;
    st_solver solver;
    bool sna_confirmation;  // associate only centroids that the star neighbourhood approach confirms
    bool roll_by_gyro;      // predict the roll of the image by measured rates
};

/// The mean body rate about the boresight by a gyro, from the frame before to this one.
/// noise_density rad^2/s is that of its white noise.
struct MeasuredRoll {
    bool is_there;
    double rate_rad_s, noise_density;
};

/// Filters of the stars on the image. rate_rad_s is the body rate, gyro_trouble why measured rolls
/// are not used; fitted is the last good attitude.
struct StarModel {
    StarModelOptions options;
    Lens lens;
    double pixel_rad;
    DetectionModel detection;
    TrackBank bank;
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
/// fit has a row for each track of the bank and is there where has_fit; uv (centroids) are where
/// the centroids were at the time of the frame.
struct StarUpdate {
    bool good, has_fit;
    RotationFit fit;
    Association association;
    const Point *uv;
};

/// Return the bytes that make_star_model() takes.
size_t star_model_bytes(const st_tracking_options &options);

/// Return the bytes of work memory of an update by so many centroids.
size_t star_model_work_bytes(const st_tracking_options &options, int centroids);

/// Make a model without tracks.
void make_star_model(const StarModelOptions &options, const st_tracking_options &tracking,
                     const Lens &lens, Arena &arena, StarModel &model);

/// Begin at an identified frame with its rate, without tracks; roll is that up to its stamp.
void start_stars(const Start &start, const MeasuredRoll &roll, StarModel &model);

/// Add tracks of stars at these centroids, which move with the body rate.
void add_star(uint32_t track_id, int32_t star, const st_centroid &centroid, bool confirmed,
              const st_tracking_options &options, StarModel &model);

/// Predict the tracks to the time of a newer frame, and update them by it. What update has is in the
/// memory of arena; work is given back.
void update_stars(int64_t stamp_ns, const st_centroid *centroids, int count,
                  const MeasuredRoll &roll, const ApparentSky &sky,
                  const st_tracking_options &options, StarModel &model, StarUpdate &update,
                  Arena &arena);

/// Predict the tracks only, to a time; stars that leave the image are dropped.
void predict_tracks(int64_t stamp_ns, const MeasuredRoll &roll,
                    const st_tracking_options &options, StarModel &model, Arena &work);

}  // namespace st
