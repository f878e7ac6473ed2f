// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// A tracker: its memory, and the order of its stages.

#include "tracker.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <new>

#include "centroid/spots.h"
#include "options.h"
#include "sky/epoch.h"

using namespace st;

namespace {

constexpr int64_t MOST_PIXELS = int64_t{1} << 27;
constexpr int DERIVED_PREDICTIONS = 1000;
// Between pixels of a camera and those that the stars of a sky file are resolved by.
constexpr double OTHER_PIXELS = 1.25;

bool has(const st_config &config, int32_t stage) {
    return (config.stages & stage) != 0;
}

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
                      Arena::padded<st_identified>(centroids);
        bytes.work = std::max(bytes.work, IdentificationStage::work_bytes(setup.identification));
    }
    if (has(config, ST_TRACKS | ST_TRUSTS)) {
        bytes.kept += Arena::padded<ApparentSky>(1) + apparent_sky_bytes(sky);
    }
    if (has(config, ST_TRACKS)) {
        bytes.kept += Arena::padded<TrackingStage>(1) + tracking_bytes(config, sky, lens);
        bytes.work = std::max(bytes.work, tracking_work_bytes(config, sky, lens));
    }
    if (has(config, ST_TRUSTS)) {
        bytes.kept += Arena::padded<TrustStage>(1) +
                      Arena::padded<double>(static_cast<size_t>(most_centroids(config)));
        bytes.work = std::max(bytes.work, trust_work_bytes(most_centroids(config)));
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

/// Set what a tracker takes from a sky file; fault (may be null) names what is wrong.
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

/// Whether predictions are finite, stars first.
bool are_possible(const st_prediction *predictions, size_t count) {
    bool target = false;
    for (size_t i = 0; i < count; ++i) {
        const st_prediction &one = predictions[i];
        if (!std::isfinite(one.u_px) || !std::isfinite(one.v_px) ||
            !std::isfinite(one.u_rate_px_s) || !std::isfinite(one.v_rate_px_s) ||
            !std::isfinite(one.sigma_px) || one.sigma_px < 0 || (target && one.hip != 0)) {
            return false;
        }
        target |= one.hip == 0;
    }
    return true;
}

/// Return a star in the pixels of a camera, where those of the image are cell x cell each.
st_centroid in_camera(st_centroid star, double cell) {
    const double square = cell * cell, shift = (cell - 1) / 2;
    star.u_px = cell * star.u_px + shift;
    star.v_px = cell * star.v_px + shift;
    star.sigma_px *= cell;
    star.cov_uu_px2 *= square;
    star.cov_uv_px2 *= square;
    star.cov_vv_px2 *= square;
    star.common_uu_px2 *= square;
    star.common_uv_px2 *= square;
    star.common_vv_px2 *= square;
    star.delay_s *= cell;
    return star;
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
        made->identified =
            kept.list<st_identified>(static_cast<size_t>(setup.identification.most_centroids));
    }
    if (has(config, ST_TRACKS | ST_TRUSTS)) {
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
            TrustStage(config, lens, *made->sky, most_centroids(config), kept);
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

int most_predictions(const st_config &config) {
    return config.capacities.predictions > 0 ? config.capacities.predictions : DERIVED_PREDICTIONS;
}

bool is_of_camera(const st_tracker &tracker, const st_image &image) {
    if (image.cell < 1 || image.width_px < 1 || image.height_px < 1 ||
        image.width_px != tracker.width / image.cell ||
        image.height_px != tracker.height / image.cell ||
        (image.type != ST_GREY8 && image.type != ST_GREY16)) {
        return false;
    }
    const int64_t bytes = image.type == ST_GREY16 ? 2 : 1;
    return image.stride_bytes >= bytes * image.width_px && image.stride_bytes % bytes == 0 &&
           reinterpret_cast<uintptr_t>(image.pixels) % static_cast<uintptr_t>(bytes) == 0;
}

Image image_of(const st_image &image, Arena &arena) {
    const int width = image.width_px, height = image.height_px;
    if (image.type == ST_GREY16) {
        return {static_cast<const uint16_t *>(image.pixels), width, height,
                static_cast<ptrdiff_t>(image.stride_bytes / 2), 16};
    }
    auto *copy = arena.take<uint16_t>(static_cast<size_t>(width) * static_cast<size_t>(height));
    for (int v = 0; v < height; ++v) {
        widen_row(static_cast<const uint8_t *>(image.pixels) + v * image.stride_bytes, width,
                  copy + static_cast<ptrdiff_t>(v) * width);
    }
    return {copy, width, height, width, 8};
}

void publish(st_tracker &tracker, const Extraction &found, double cell,
             const ExposureLimits &exposure, bool windowed, st_extraction &extraction) {
    tracker.centroids.clear();
    tracker.rejected.clear();
    List<st_centroid> stars = found.stars;
    if (stars.count > tracker.centroids.capacity) {
        sort_by_flux(stars, tracker.work);
    }
    for (const st_centroid &star : stars) {
        tracker.centroids.add(in_camera(star, cell));
    }
    for (st_rejected one : found.rejections.spots) {
        one.u_px = cell * one.u_px + (cell - 1) / 2;
        one.v_px = cell * one.v_px + (cell - 1) / 2;
        tracker.rejected.add(one);
    }
    const Streak unknown{NAN, NAN, NAN, NAN, NAN};
    const Streak &streak = found.streaked ? found.streak : unknown;
    extraction = {};
    extraction.background_dn = found.background_dn;
    extraction.noise_dn = found.noise_dn;
    extraction.psf_sigma_px = found.psf_sigma_px;
    extraction.exposure_least_s = exposure.least_s;
    extraction.exposure_most_s = exposure.most_s;
    extraction.streak_u_px = streak.u_px;
    extraction.streak_v_px = streak.v_px;
    extraction.streak_roll_rad = streak.roll;
    extraction.streak_at_u_px = streak.u0;
    extraction.streak_at_v_px = streak.v0;
    extraction.centroids = tracker.centroids.count;
    extraction.centroids_left_out = tracker.centroids.left_out;
    extraction.rejected = found.rejections.count();
    extraction.rejected_listed = tracker.rejected.count;
    std::memcpy(extraction.rejected_by_kind, found.rejections.by_kind,
                sizeof(extraction.rejected_by_kind));
    extraction.windowed = windowed ? 1 : 0;
    extraction.reason = found.reason;
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

st_status st_extract(st_tracker *tracker, int64_t stamp_ns, const st_image *image,
                     const st_prediction *predictions, size_t count, int64_t predicted_ns,
                     int32_t lost, st_extraction *extraction) {
    if (tracker == nullptr || image == nullptr || image->pixels == nullptr ||
        extraction == nullptr || (predictions == nullptr && count > 0)) {
        return ST_NULL_POINTER;
    }
    if (!has_stage(*tracker, ST_EXTRACTS)) {
        return ST_NO_STAGE;
    }
    if (!is_of_camera(*tracker, *image)) {
        return ST_BAD_IMAGE;
    }
    if (count > static_cast<size_t>(most_predictions(tracker->config))) {
        return ST_TOO_MANY;
    }
    if (stamp_ns < 0 || predicted_ns < 0 || !are_possible(predictions, count) ||
        !std::isfinite(image->exposure_s) || image->exposure_s < 0) {
        return ST_BAD_INPUT;
    }
    const Arena::Scope scope(tracker->work);
    const Extraction &found = tracker->extraction.process(
        stamp_ns, image_of(*image, tracker->work), image->exposure_s,
        {predictions, static_cast<int>(count), predicted_ns, image->cell}, lost != 0,
        tracker->work);
    publish(*tracker, found, image->cell, tracker->extraction.exposure(),
            tracker->extraction.windowed(), *extraction);
    return ST_OK;
}

const st_centroid *st_centroids(const st_tracker *tracker, size_t *count) {
    return tracker == nullptr ? nullptr : listed(tracker->centroids, count);
}

const st_rejected *st_rejections(const st_tracker *tracker, size_t *count) {
    return tracker == nullptr ? nullptr : listed(tracker->rejected, count);
}

st_status st_identify(st_tracker *tracker, int64_t stamp_ns, const st_centroid *centroids,
                      size_t count, double slice_s, const volatile uint32_t *stop,
                      st_identification *identification) {
    if (tracker == nullptr || identification == nullptr || (centroids == nullptr && count > 0)) {
        return ST_NULL_POINTER;
    }
    if (!has_stage(*tracker, ST_IDENTIFIES) || !tracker->identification.has_pairs()) {
        return ST_NO_STAGE;
    }
    if (count > static_cast<size_t>(tracker->identification.most_centroids())) {
        return ST_TOO_MANY;
    }
    if (stamp_ns < 0 || !(slice_s > 0)) {
        return ST_BAD_INPUT;
    }
    tracker->identification.begin(stamp_ns, centroids, static_cast<int>(count), tracker->work);
    return st_identify_on(tracker, slice_s, stop, identification);
}

st_status st_identify_on(st_tracker *tracker, double slice_s, const volatile uint32_t *stop,
                         st_identification *identification) {
    if (tracker == nullptr || identification == nullptr) {
        return ST_NULL_POINTER;
    }
    if (!has_stage(*tracker, ST_IDENTIFIES)) {
        return ST_NO_STAGE;
    }
    if (!(slice_s > 0) || !tracker->identification.is_searching()) {
        return ST_BAD_INPUT;
    }
    tracker->identification.proceed(slice_s, stop, *identification, tracker->identified,
                                    tracker->work);
    return ST_OK;
}

const st_identified *st_identified_stars(const st_tracker *tracker, size_t *count) {
    return tracker == nullptr ? nullptr : listed(tracker->identified, count);
}

}  // extern "C"
