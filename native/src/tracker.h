// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// What calls for a tracker share: its memory, checks of input, lists of results.

#pragma once

#include "centroid/extraction_stage.h"
#include "integrity/trust_stage.h"
#include "maths/arena.h"
#include "startracker.h"
#include "track/frame_search.h"
#include "track/tracking_stage.h"

struct st_tracker {
    st_config config;
    int width, height;
    st::SkyFile sky_file;
    st::ApparentSky *sky;  // null for a tracker without a sky file
    st::ExtractionStage extraction;
    st::IdentificationStage identification;
    st::FrameSearch frames;
    st::TrackingStage *tracking;  // null without the stage, as
    st::TrustStage *trust;        // this
    bool was_identified;
    int64_t identified_ns;
    st::List<st_centroid> centroids;
    st::List<st_rejected> rejected;
    st::List<st_identified> identified;
    st::Arena work;  // given back after each call
};

namespace st {

/// Return the items of a list and their number, where it is asked for.
template <class T>
const T *listed(const List<T> &list, size_t *count) {
    if (count != nullptr) {
        *count = static_cast<size_t>(list.count);
    }
    return list.item;
}

/// Most predictions that a tracker of these options takes.
int most_predictions(const st_config &config);

/// Most stars of an attitude that is to be trusted: centroids or tracks of a frame.
int most_trusted(const st_config &config);

/// Whether options have any of some stages, or a tracker has memory for one.
inline bool has(const st_config &config, int32_t stages) {
    return (config.stages & stages) != 0;
}
inline bool has_stage(const st_tracker &tracker, int32_t stage) {
    return has(tracker.config, stage);
}

/// What a tracker is made of in addition to its options: the sky file where it has one, and what
/// it identifies stars by where it does.
struct Setup {
    SkyFile sky_file;
    IdentificationSetup identification;
};

/// Set what a tracker takes from a sky file, null where no stage needs one; fault (may be null) names
/// what is wrong.
st_status set_up(const st_config &config, const st_camera &camera, const st_sky *sky, Setup &setup,
                 st_fault *fault);

/// Bytes of a tracker of checked options and camera.
size_t tracker_bytes(const st_config &config, const st_camera &camera, const Setup &setup);

/// Make one, as st_create().
st_status make_tracker(void *memory, size_t bytes, const st_config &config,
                       const st_camera &camera, const Setup &setup, st_tracker **tracker);

/// Whether a tracker of these options and camera is possible.
st_status check_tracker(const st_config *config, const st_camera *camera, st_fault *fault);

/// Whether a tracker extracts stars, and an image is one of its camera.
st_status check_pixels(const st_tracker *tracker, const st_image *image);
/// And whether its stamp and exposure are possible.
st_status check_image(const st_tracker *tracker, int64_t stamp_ns, const st_image *image);

/// Whether a tracker has a stage, and a frame is one that it takes; exposure_s may be null.
st_status check_frame(const st_tracker &tracker, int32_t stage, int64_t stamp_ns,
                      const st_centroid *centroids, size_t count, const double *exposure_s);

/// Return an image as uint16: that of the caller, or a copy of one of 8 bits in the arena.
Image image_of(const st_image &image, Arena &arena);

/// Fill the lists of a tracker and the result with what was found. Each pixel of the image is
/// cell x cell pixels of the camera.
void publish(st_tracker &tracker, const Extraction &found, double cell,
             const ExposureLimits &exposure, bool windowed, st_extraction &extraction);

// --- whole frames ---

/// Whether a tracker has what whole frames need, and a frame is one that it takes.
st_status check_whole(const st_tracker &tracker, int64_t stamp_ns, const st_centroid *centroids,
                      size_t count, const double *exposure_s, const st_result *result);

/// Begin a frame: false for one that is not newer than the one before, which is not used.
bool begin(st_tracker &tracker, int64_t stamp_ns, st_result &result);

/// Identify a frame, or go on with one before.
void identify(st_tracker &tracker, int64_t stamp_ns, const st_centroid *centroids, size_t count,
              st_result &result);

/// Return why there is no attitude, or that it is trusted.
st_reason reason_of_result(const st_result &result, const st_reason &trust);

}  // namespace st
