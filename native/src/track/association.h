// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Joint probabilistic data association (JPDA): which centroid belongs to which track.
//
// Steps 2 to 6 of the filter of Sadeghi, Sabahi and Saberali, with false centroids as a Poisson
// process of known density (Bar-Shalom and Fortmann 1988) instead of phi! / V^phi: then clusters of
// tracks without a common centroid are independent.

#pragma once

#include <cstddef>
#include <cstdint>

#include "camera/lens.h"
#include "maths/arena.h"
#include "maths/covariance2.h"

namespace st {

/// Bound of the steps of a frame: pairings of track and shared centroid (missed counts as one)
/// times the states after each track (see marginalise()). Twelve stars that all share twelve
/// centroids, 10^10 events, are within it and exact. Beyond it only the most probable states stay.
constexpr int MAX_STEPS = 1'000'000;

/// Bound of the states of a cluster, which is that of its memory; the same twelve stars have 24 000.
constexpr int MOST_STATES = 65536;

/// Centroids in the gate of one track that are kept, those of the largest densities.
constexpr int MOST_PAIRINGS = 128;

/// Gate, probabilities of a detection, and the area of the image.
///
/// gate is a squared Mahalanobis distance; gate_probability that of a detected star to be inside
/// it; detection_probability that of a star to have a centroid; image_px2 is the area in which
/// false centroids occur.
struct DetectionModel {
    double gate, gate_probability, detection_probability, image_px2;
};

/// Return the model of these options; image_px2 is that of the lens.
DetectionModel detection_model(const st_tracking_options &options, const Lens &lens);

/// A centroid that a track may have; value is a density per px^2, then a weight, then the
/// probability of it.
struct Pairing {
    int32_t centroid;
    double value;
};

/// Where stars are expected, or centroids were found: places (count) with their errors (count).
struct Places {
    int count;
    const Point *uv;
    const Covariance2 *error;
};

/// Of each track the hypothesis that its star was missed, and those of the centroids in its gate,
/// in the order of the centroids; all others are impossible.
struct Association {
    int tracks, centroids;
    double *missed;         // (tracks)
    int32_t *start;         // (tracks + 1): pairings of track n are start[n] to start[n + 1] - 1
    List<Pairing> pairing;  // left_out counts those beyond MOST_PAIRINGS a track
    bool *unassociated;     // (centroids): in no gate
    int states_left_out;    // of a cluster that is beyond MAX_STEPS

    const Pairing *begin(int track) const { return pairing.item + start[track]; }
    const Pairing *end(int track) const { return pairing.item + start[track + 1]; }
    Pairing *begin(int track) { return pairing.item + start[track]; }
    Pairing *end(int track) { return pairing.item + start[track + 1]; }

    /// Whether it is more probable than not that the star of a track was missed.
    bool is_missed(int track) const { return missed[track] > 0.5; }

    /// Return the most probable pairing of a track, the first of equal ones; null for none.
    const Pairing *best(int track) const;
};

/// Return the bytes that association_for() takes.
size_t association_bytes(int tracks, int centroids);

/// Return an association without pairings: every star is missed, every centroid in no gate.
Association association_for(int tracks, int centroids, Arena &arena);

/// Return the bytes of work memory of associate().
size_t association_work_bytes(int tracks, int centroids);

/// Associate centroids with tracks, of at most so many as the association is for.
///
/// The density of false centroids is that of the centroids in no gate. Errors are finite, those of
/// centroids positive definite, those of predictions positive semidefinite.
void associate(const Places &predicted, const Places &centroids, const DetectionModel &detection,
               Association &association, Arena &work);

// --- its steps ---

/// Make the pairings those in a gate, with the density of the centroid about the prediction.
void gate_centroids(const Places &predicted, const Places &centroids, double gate,
                    Association &association, Arena &work);

/// Make densities factors of joint events, relative to every centroid being false;
/// clutter_px2 > 0 is the density of false centroids per px^2.
void weigh_events(const DetectionModel &detection, double clutter_px2, Association &association);

/// Make weights the association probabilities. Return the logarithm of the sum over all joint events
/// of the product of their weights.
///
/// A joint event gives each track one centroid or none and each centroid to one track at most; its
/// probability is proportional to the product of its weights. Exact, up to max_steps and 64
/// centroids that are shared at a time.
double marginalise(Association &association, int64_t max_steps, Arena &work);

}  // namespace st
