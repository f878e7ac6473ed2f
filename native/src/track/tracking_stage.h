// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The stage behind st_track(): a filter of tracks, and its results.

#pragma once

#include "track/track_filter.h"

namespace st {

class TrackingStage {
public:
    TrackFilter filter;

    TrackingStage() = default;

    /// Take what stays between frames out of the arena.
    TrackingStage(const st_config &config, const Lens &lens, ApparentSky &sky, Arena &arena);

    /// Forget all frames and rates.
    void reset();

    /// Fill in what is known after a call, and the list of tracks.
    void publish(st_tracking &tracking, Arena &arena);

    /// Fill in state, reasons and counts alone; attitude and tracks stay those of the frame.
    void publish_state(st_tracking &tracking);

    /// Return the predictions of the newest frame, computed when they are asked for; null where there
    /// is no attitude.
    const List<st_prediction> *predictions();

    const List<st_star_track> &tracks() const { return tracks_; }

private:
    List<st_star_track> tracks_;
    List<st_prediction> predictions_;
    bool predicted_ = false, has_predictions_ = false;
};

/// Most centroids of a frame that a tracker of these options takes.
int most_centroids(const st_config &config);

/// Bytes of what stays between frames, and of work memory.
size_t tracking_bytes(const st_config &config, const SkyFile &sky, const Lens &lens);
size_t tracking_work_bytes(const st_config &config, const SkyFile &sky, const Lens &lens);

}  // namespace st
