// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "track/tracking_stage.h"

#include "track/prediction.h"

namespace st {
namespace {

constexpr int DERIVED_FRAMES = 64;
/// 10 s at 100 Hz, of a pause or an identification that comes late.
constexpr int DERIVED_RATES = 1000;

int given_or(int32_t capacity, int derived) {
    return capacity > 0 ? capacity : derived;
}

TrackCapacities capacities_of(const st_config &config, const SkyFile &sky, const Lens &lens) {
    const st_capacities &given = config.capacities;
    return {given_or(given.tracks, config.tracking.max_stars), most_centroids(config),
            given_or(given.frames, DERIVED_FRAMES), given_or(given.rates, DERIVED_RATES),
            stars_in_view_capacity(sky, lens)};
}

size_t most_predicted(const st_config &config, const TrackCapacities &capacities) {
    return static_cast<size_t>(
        given_or(config.capacities.predictions,
                 static_cast<int>(SPARE_STARS * static_cast<double>(capacities.tracks))));
}

st_gyro_use use_of_gyro(const TrackFilter &filter) {
    if (filter.gyro.count() == 0) {
        return ST_GYRO_NONE;
    }
    return filter.uses_gyro() ? ST_GYRO_USED : ST_GYRO_UNUSED;
}

}  // namespace

TrackingStage::TrackingStage(const st_config &config, const Lens &lens, ApparentSky &sky,
                             Arena &arena) {
    const TrackCapacities capacities = capacities_of(config, *sky.file, lens);
    filter = TrackFilter(config, lens, sky, capacities, arena);
    tracks_ = arena.list<st_star_track>(static_cast<size_t>(capacities.tracks));
    predictions_ = arena.list<st_prediction>(most_predicted(config, capacities));
}

size_t tracking_bytes(const st_config &config, const SkyFile &sky, const Lens &lens) {
    const TrackCapacities capacities = capacities_of(config, sky, lens);
    return TrackFilter::bytes(config, capacities) +
           Arena::padded<st_star_track>(static_cast<size_t>(capacities.tracks)) +
           Arena::padded<st_prediction>(most_predicted(config, capacities));
}

size_t tracking_work_bytes(const st_config &config, const SkyFile &sky, const Lens &lens) {
    return TrackFilter::work_bytes(config, capacities_of(config, sky, lens));
}

void TrackingStage::reset() {
    filter.reset();
    tracks_.clear();
    predicted_ = false;
}

void TrackingStage::publish(st_tracking &tracking, Arena &arena) {
    filter.publish(tracks_);
    tracking = {};
    filter.fill(tracking.attitude, tracking.budget, arena);
    filter.fill_of_frame(tracking.frame_attitude, tracking.frame_budget, arena);
    tracking.tracks = tracks_.count;
    tracking.tracks_left_out = tracks_.left_out;
    publish_state(tracking);
}

void TrackingStage::publish_state(st_tracking &tracking) {
    predicted_ = false;
    tracking.residual_px = filter.residual_px;
    tracking.stamp_sigma_s = filter.stamp_sigma_s();
    tracking.state = filter.state;
    tracking.gyro = use_of_gyro(filter);
    tracking.stars_matched = filter.stars_matched;
    tracking.frames_since_fix = filter.frames_since_fix;
    tracking.late_frames = filter.late_frames;
    tracking.rejected_centroids = filter.rejected_centroids;
    tracking.checks_passed = filter.checks_passed;
    tracking.reason = filter.reason;
    tracking.contradiction = filter.contradiction;
    tracking.gyro_trouble = filter.gyro_trouble();
}

const List<st_prediction> *TrackingStage::predictions() {
    if (!predicted_) {
        has_predictions_ = filter.predict(predictions_);
        predicted_ = true;
    }
    return has_predictions_ ? &predictions_ : nullptr;
}

}  // namespace st
