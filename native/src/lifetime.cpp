// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// A tracker from st_create() on: its memory, its stages, its options.

#include <algorithm>
#include <cmath>
#include <new>

#include "options.h"
#include "sky/epoch.h"
#include "tracker.h"

using namespace st;

namespace {

constexpr int64_t MOST_PIXELS = int64_t{1} << 27;
constexpr int DERIVED_PREDICTIONS = 1000;
// Between pixels of a camera and those that the stars of a sky file are resolved by.
constexpr double OTHER_PIXELS = 1.25;

/// What stays between calls, and work memory.
struct Bytes {
    size_t kept, work;
};

size_t extraction_work_bytes(const st_config &config, int width, int height) {
    const auto pixels = static_cast<size_t>(width) * static_cast<size_t>(height);
    return Arena::padded<std::byte>(work_bytes(width, height, limits_of(config, width, height))) +
           8 * Arena::padded<Place>(static_cast<size_t>(most_predictions(config))) +
           Arena::padded<uint16_t>(pixels);
}

Bytes bytes_of(const st_config &config, const st_camera &camera, const Setup &setup) {
    const int width = camera.width_px, height = camera.height_px;
    const Lens lens = lens_of(camera);
    const SkyFile &sky = setup.sky_file;
    Bytes bytes{Arena::padded<st_tracker>(1), 0};
    if (has(config, ST_EXTRACTS)) {
        const ExtractionLimits limits = limits_of(config, width, height);
        bytes.kept += stage_bytes(config, width, height) +
                      Arena::padded<st_centroid>(static_cast<size_t>(most_centroids(config))) +
                      Arena::padded<st_rejected>(static_cast<size_t>(limits.rejected));
        bytes.work = extraction_work_bytes(config, width, height);
    }
    if (has(config, ST_IDENTIFIES)) {
        const auto centroids = static_cast<size_t>(setup.identification.most_centroids);
        bytes.kept += IdentificationStage::bytes(setup.identification) +
                      FrameSearch::bytes(setup.identification.most_centroids) +
                      Arena::padded<st_identified>(centroids);
        bytes.work = std::max(bytes.work, FrameSearch::work_bytes(setup.identification));
    }
    if (sky.stars > 0) {
        bytes.kept += Arena::padded<ApparentSky>(1) + apparent_sky_bytes(sky);
    }
    if (has(config, ST_TRACKS)) {
        bytes.kept += Arena::padded<TrackingStage>(1) + tracking_bytes(config, sky, lens);
        bytes.work = std::max(bytes.work, tracking_work_bytes(config, sky, lens));
    }
    if (has(config, ST_TRUSTS)) {
        bytes.kept += Arena::padded<TrustStage>(1) +
                      Arena::padded<double>(static_cast<size_t>(most_trusted(config)));
        bytes.work = std::max(bytes.work, trust_work_bytes(most_trusted(config)));
    }
    return bytes;
}

/// Leave the first stars, those up to a magnitude: in float, as the catalogue was made of floats.
void leave_out_faint(double magnitude_limit, SkyFile &sky) {
    const auto limit = static_cast<float>(magnitude_limit);
    const double *end = std::upper_bound(
        sky.magnitude, sky.magnitude + sky.stars, limit,
        [](float most, double magnitude) { return most < static_cast<float>(magnitude); });
    sky.stars = std::max(static_cast<int32_t>(end - sky.magnitude), 1);
}

}  // namespace

namespace st {

st_status check_tracker(const st_config *config, const st_camera *camera, st_fault *fault) {
    st_status status = st_check_config(config, fault);
    if (status == ST_OK) {
        status = st_check_camera(camera, fault);
    }
    if (status != ST_OK) {
        return status;
    }
    const double pixels = static_cast<double>(camera->width_px) * camera->height_px;
    if (pixels > static_cast<double>(MOST_PIXELS)) {
        if (fault != nullptr) {
            *fault = {"width_px height_px", pixels, 1.0, static_cast<double>(MOST_PIXELS)};
        }
        return ST_OUT_OF_RANGE;
    }
    return ST_OK;
}

st_status set_up(const st_config &config, const st_camera &camera, const st_sky *sky, Setup &setup,
                 st_fault *fault) {
    setup = {};
    if (!has(config, ST_IDENTIFIES | ST_TRACKS | ST_TRUSTS)) {
        return ST_OK;
    }
    if (sky == nullptr || sky->file == nullptr) {
        return ST_NULL_POINTER;
    }
    if (reinterpret_cast<uintptr_t>(sky->file) % ALIGNMENT != 0) {
        return ST_MISALIGNED;
    }
    SkyFile &file = setup.sky_file;
    if (!open_sky(*sky, file, fault)) {
        return ST_BAD_SKY;
    }
    if (has(config, ST_IDENTIFIES)) {
        const double pixel_rad = 1 / std::sqrt(camera.fx_px * camera.fy_px);
        const double least = file.pixel_rad / OTHER_PIXELS, most = file.pixel_rad * OTHER_PIXELS;
        if (!(pixel_rad >= least && pixel_rad <= most)) {
            if (fault != nullptr) {
                *fault = {"pixel_rad", pixel_rad, least, most};
            }
            return ST_BAD_SKY;
        }
        setup.identification = setup_of(config, file, most_centroids(config));
    }
    if (has(config, ST_TRACKS)) {
        leave_out_faint(config.tracking.magnitude_limit, file);
    }
    return ST_OK;
}

size_t tracker_bytes(const st_config &config, const st_camera &camera, const Setup &setup) {
    const Bytes needed = bytes_of(config, camera, setup);
    return needed.kept + needed.work;
}

st_status make_tracker(void *memory, size_t bytes, const st_config &config,
                       const st_camera &camera, const Setup &setup, st_tracker **tracker) {
    if (reinterpret_cast<uintptr_t>(memory) % ALIGNMENT != 0) {
        return ST_MISALIGNED;
    }
    const Bytes needed = bytes_of(config, camera, setup);
    if (bytes < needed.kept + needed.work) {
        return ST_TOO_LITTLE_MEMORY;
    }
    const int width = camera.width_px, height = camera.height_px;
    const Lens lens = lens_of(camera);
    Arena kept(memory, needed.kept);
    auto *made = new (kept.take<st_tracker>(1)) st_tracker{};
    made->config = config;
    made->width = width;
    made->height = height;
    made->sky_file = setup.sky_file;
    if (has(config, ST_EXTRACTS)) {
        made->extraction = ExtractionStage(config, width, height, kept);
        made->centroids = kept.list<st_centroid>(static_cast<size_t>(most_centroids(config)));
        made->rejected =
            kept.list<st_rejected>(static_cast<size_t>(limits_of(config, width, height).rejected));
    }
    if (has(config, ST_IDENTIFIES)) {
        made->identification =
            IdentificationStage(config.identification, camera, setup.identification, kept);
        made->frames = FrameSearch(setup.identification.most_centroids, kept);
        made->identified =
            kept.list<st_identified>(static_cast<size_t>(setup.identification.most_centroids));
    }
    if (made->sky_file.stars > 0) {
        made->sky = new (kept.take<ApparentSky>(1)) ApparentSky{};
        start_sky(made->sky_file, epoch_after(made->sky_file.epoch_year, config.epoch_year), kept,
                  *made->sky);
    }
    if (has(config, ST_TRACKS)) {
        made->tracking =
            new (kept.take<TrackingStage>(1)) TrackingStage(config, lens, *made->sky, kept);
    }
    if (has(config, ST_TRUSTS)) {
        made->trust = new (kept.take<TrustStage>(1))
            TrustStage(config, lens, *made->sky, most_trusted(config), kept);
    }
    made->work = Arena(static_cast<std::byte *>(memory) + needed.kept, needed.work);
    *tracker = made;
    return ST_OK;
}

int most_centroids(const st_config &config) {
    const st_extraction_options &options = config.extraction;
    return config.capacities.centroids > 0
               ? config.capacities.centroids
               : std::max(options.max_stars, options.max_stars_lost) + options.max_stars;
}

int most_trusted(const st_config &config) {
    return std::max({most_centroids(config), config.capacities.tracks, config.tracking.max_stars});
}

int most_predictions(const st_config &config) {
    return config.capacities.predictions > 0 ? config.capacities.predictions : DERIVED_PREDICTIONS;
}

}  // namespace st

extern "C" {

st_status st_size(const st_config *config, const st_camera *camera, const st_sky *sky,
                  size_t *bytes) {
    if (bytes == nullptr) {
        return ST_NULL_POINTER;
    }
    Setup setup;
    st_status status = check_tracker(config, camera, nullptr);
    if (status == ST_OK) {
        status = set_up(*config, *camera, sky, setup, nullptr);
    }
    if (status == ST_OK) {
        *bytes = tracker_bytes(*config, *camera, setup);
    }
    return status;
}

st_status st_create(void *memory, size_t bytes, const st_config *config, const st_camera *camera,
                    const st_sky *sky, st_tracker **tracker, st_fault *fault) {
    if (memory == nullptr || tracker == nullptr) {
        return ST_NULL_POINTER;
    }
    Setup setup;
    st_status status = check_tracker(config, camera, fault);
    if (status == ST_OK) {
        status = set_up(*config, *camera, sky, setup, fault);
    }
    return status == ST_OK ? make_tracker(memory, bytes, *config, *camera, setup, tracker)
                           : status;
}

st_status st_reset(st_tracker *tracker) {
    if (tracker == nullptr) {
        return ST_NULL_POINTER;
    }
    tracker->extraction.reset();
    tracker->identification.reset();
    tracker->frames.reset();
    tracker->centroids.clear();
    tracker->rejected.clear();
    tracker->identified.clear();
    tracker->was_identified = false;
    if (tracker->tracking != nullptr) {
        tracker->tracking->reset();
    }
    if (tracker->trust != nullptr) {
        tracker->trust->validator.reset();
    }
    return ST_OK;
}

st_status st_change_options(st_tracker *tracker, const st_config *config, st_fault *fault) {
    if (tracker == nullptr) {
        return ST_NULL_POINTER;
    }
    const st_status status = st_check_config(config, fault);
    if (status != ST_OK) {
        return status;
    }
    if (!only_live_differ(tracker->config, *config, fault)) {
        return ST_READ_ONLY;
    }
    tracker->config = *config;
    if (has_stage(*tracker, ST_EXTRACTS)) {
        tracker->extraction.set_options(config->extraction);
    }
    if (tracker->tracking != nullptr) {
        tracker->tracking->filter.set_limits(config->tracking);
    }
    if (tracker->trust != nullptr) {
        tracker->trust->validator.set_limits(config->trust);
    }
    return ST_OK;
}

}  // extern "C"
