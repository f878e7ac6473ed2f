// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// What calls for a tracker share: its memory, checks of input, lists of results.

#pragma once

#include "centroid/extraction_stage.h"
#include "integrity/trust_stage.h"
#include "maths/arena.h"
#include "startracker.h"
#include "track/tracking_stage.h"

struct st_tracker {
    st_config config;
    int width, height;
    st::SkyFile sky_file;
    st::ApparentSky *sky;  // null for a tracker that only extracts
    st::ExtractionStage extraction;
    st::TrackingStage *tracking;  // null without the stage, as
    st::TrustStage *trust;        // this
    bool was_identified;
    int64_t identified_ns;
    st::List<st_centroid> centroids;
    st::List<st_rejected> rejected;
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

/// Whether options differ from those before in live ones only; fault names the first other one.
bool only_live_differ(const st_config &config, const st_config &before, st_fault *fault);

/// Most predictions that a tracker of these options takes.
int most_predictions(const st_config &config);

/// Whether an image is one of the camera of a tracker.
bool is_of_camera(const st_tracker &tracker, const st_image &image);

/// Return an image as uint16: that of the caller, or a copy of one of 8 bits in the arena.
Image image_of(const st_image &image, Arena &arena);

/// Fill the lists of a tracker and the result with what was found. Each pixel of the image is
/// cell x cell pixels of the camera.
void publish(st_tracker &tracker, const Extraction &found, double cell,
             const ExposureLimits &exposure, bool windowed, st_extraction &extraction);

}  // namespace st
