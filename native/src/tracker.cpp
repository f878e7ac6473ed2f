// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The order of the stages of a frame, nothing else.

#include "tracker.h"

using namespace st;

namespace {

/// Track, trust and identify the stars of a frame.
void follow(st_tracker &tracker, int64_t stamp_ns, const st_centroid *centroids, size_t count,
            const double *exposure_s, int32_t windowed, st_result &result) {
    // The state before the frame counts, as where the stages work side by side.
    const st_state state = tracker.tracking->filter.follows() ? ST_TRACKING : ST_LOST;
    const bool due = has_stage(tracker, ST_IDENTIFIES) &&
                     (tracker.frames.is_searching() ||
                      st_identification_is_due(&tracker, stamp_ns, state, windowed) != 0);
    st_track(&tracker, stamp_ns, centroids, count, exposure_s, &result.tracking);
    size_t tracks = 0;
    const st_star_track *first = st_tracks(&tracker, &tracks);
    st_trusted trusted;
    st_trust(&tracker, stamp_ns, first, tracks, &result.tracking.attitude, &trusted);
    result.attitude = trusted.attitude;
    if (due) {
        identify(tracker, stamp_ns, centroids, count, result);
    }
    result.reason = reason_of_result(result, trusted.reason);
    look(stamp_ns, *tracker.sky);
    result.aberration = tracker.sky->observer.aberration;
}

}  // namespace

extern "C" {

st_status st_process_image(st_tracker *tracker, int64_t stamp_ns, const st_image *image,
                           st_result *result) {
    st_status status = check_image(tracker, stamp_ns, image);
    if (status == ST_OK) {
        status = check_whole(*tracker, stamp_ns, nullptr, 0, nullptr, result);
    }
    if (status != ST_OK || !begin(*tracker, stamp_ns, *result)) {
        return status;
    }
    size_t count = 0;
    st_extraction &found = result->extraction;
    const st_prediction *predictions = st_predictions(tracker, &count);
    status = st_extract(tracker, stamp_ns, image, predictions, count,
                        tracker->tracking->filter.stamp_ns(), 1, &found);
    if (status == ST_OK) {
        const double exposure_s[2] = {found.exposure_least_s, found.exposure_most_s};
        const List<st_centroid> &stars = tracker->centroids;
        follow(*tracker, stamp_ns, stars.item, static_cast<size_t>(stars.count), exposure_s,
               found.windowed, *result);
    }
    return status;
}

st_status st_process_centroids(st_tracker *tracker, int64_t stamp_ns, const st_centroid *centroids,
                               size_t count, const double *exposure_s, int32_t windowed,
                               st_result *result) {
    if (tracker == nullptr) {
        return ST_NULL_POINTER;
    }
    const st_status status = check_whole(*tracker, stamp_ns, centroids, count, exposure_s, result);
    if (status == ST_OK && begin(*tracker, stamp_ns, *result)) {
        result->extraction.centroids = static_cast<int32_t>(count);
        result->extraction.windowed = windowed;
        follow(*tracker, stamp_ns, centroids, count, exposure_s, windowed, *result);
    }
    return status;
}

}  // extern "C"
