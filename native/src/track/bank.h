// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// All tracks of a tracker: one for each star that is followed, in the order of their starts.

#pragma once

#include <cstdint>

#include "sky/sky.h"
#include "track/association.h"
#include "track/motion_models.h"

namespace st {

/// A star that is followed. star is an index into the sky file; variance that of the last centroid
/// seen, px^2 per axis; age and missed count frames; flux, snr and sigma of the centroid are NaN when
/// missed, residual_px, its distance from the prediction, also when just started; probability is
/// that of its most probable centroid.
struct Track {
    StarState state;
    StarCovariance covariance;
    double variance, flux_dn, snr, sigma_px, residual_px, probability;
    uint32_t track_id;
    int32_t star, age, missed;
    bool confirmed;

    Point uv() const { return {state[0], state[2]}; }
    Covariance2 uv_covariance() const {
        return {covariance[0][0], covariance[0][2], covariance[2][2]};
    }
    /// 1 sigma of uv per axis, the mean of both.
    double uv_sigma_px() const { return std::sqrt((covariance[0][0] + covariance[2][2]) / 2); }
    /// Confirmed, and with a centroid in the last frame.
    bool is_detected() const { return confirmed && missed == 0; }
};

/// In the order of their starts; left_out counts those that had no place.
using TrackList = List<Track>;

/// Return a new track of a centroid, of variance px^2 per axis, at rest.
Track started_track(uint32_t track_id, int32_t star, const st_centroid &centroid, double variance,
                    bool confirmed);

/// Keep the tracks of a mask (count), in their order.
void select(TrackList &bank, const bool *kept);

/// Whether a star has a track.
bool has_star(const TrackList &bank, int32_t star);

/// Bring a track to the next frame with its most probable centroid of an association, of which it is
/// track n; predicted is where it was expected, variance (M) that of the centroids (M) in px^2.
/// It counts as missed when that is more probable than not.
void follow(Track &track, const Association &association, int n, const Point &predicted,
            const Point *uv, const st_centroid *centroids, const double *variance);

/// The same of a frame that is not used: missed.
void miss(Track &track);

/// Whether a track is kept: not near a planet, and not missed too often. Confirmed ones may be
/// missed in most_missed frames in a row, new ones in half of their age.
bool is_kept(const Track &track, bool crowded, double most_missed);

/// Whether a track is kept after a fit of which normalised is its residual in sigma: no outlier.
inline bool is_kept_after_fit(const Track &track, double normalised, double most_sigmas) {
    return !(track.missed == 0 && normalised > most_sigmas);
}

/// Confirm a track that was seen in the last frame, from an age of confirm_frames on.
void confirm(Track &track, int confirm_frames);

/// Return tracks for publication; unless identified, without hip and magnitude. Returns how many.
int publish(const TrackList &bank, const SkyFile &file, bool identified, st_star_track *tracks,
            int capacity);

}  // namespace st
