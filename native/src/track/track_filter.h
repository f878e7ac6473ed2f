// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The filter of the tracks: from identified frames of stars to tracks of stars.
//
//     LOST       -> ACQUIRING  an identified frame
//     ACQUIRING  -> TRACKING   a second one within max_gap_s, at max_rate_deg_s at most
//     any        -> TRACKING   an identified frame that agrees with a hint, unless TRACKING
//                -> ACQUIRING  a second one at a higher rate, which becomes the first
//                -> LOST       no second one within max_gap_s
//     TRACKING   -> TRACKING   other stars than those followed, where the prediction has them
//                -> ACQUIRING  an identified frame that contradicts the tracks
//                -> LOST       max_bad_frames bad frames in a row, or max_gap_s without stars
//     any        -> LOST       reset(), or time jumps back

#pragma once

#include "integrity/row_pattern.h"
#include "track/attitude_model.h"
#include "track/frame.h"
#include "track/in_view.h"
#include "track/new_stars.h"
#include "track/repetition.h"
#include "track/star_models.h"
#include "track/start.h"

namespace st {

/// Lengths of the lists of a filter; view is that of the catalogue stars in and near the image.
struct TrackCapacities {
    int tracks, centroids, frames, rates, view;
};

/// An attitude of a frame whose stars agree.
struct TrackedAttitude {
    int64_t stamp_ns;
    Quaternion quaternion;
    Matrix3 covariance;  // of the model, without errors that last
    double chi2, residual_px;
    int stars;
};

/// Whether a frame is newer than the one before, late, or so old that time was set back.
enum class Order { NEWER, LATE, BACK };

/// Feed update() with every frame and identified() with the identifications, in any interleaving: an
/// identification may come some frames late or before its own update(). acquire_new_stars() may
/// follow update(). The sky is that of the observers given to it.
class TrackFilter {
public:
    TrackFilter() = default;

    /// Take what stays between frames out of the arena.
    TrackFilter(const st_config &config, const Lens &lens, ApparentSky &sky,
                const TrackCapacities &capacities, Arena &arena);

    /// Forget everything but the counts and the track numbers.
    void reset();

    /// Use live options, without loss of lock; the others must be those of before.
    void set_limits(const st_tracking_options &options);

    Order order(int64_t stamp_ns) const;

    /// That of the newest frame; 0 before the first.
    int64_t stamp_ns() const { return has_stamp_ ? stamp_ns_ : 0; }

    /// Whether the stars of the newest frame were where the tracks have them.
    bool follows() const { return state == ST_TRACKING && frames_since_fix == 0; }

    /// Process a frame; false for one that is not newer than the one before, which counts as late.
    bool update(int64_t stamp_ns, const st_centroid *centroids, int count,
                const double exposure_s[2], Arena &arena);

    /// Process an identified frame: hip of each centroid, 0 where it is unknown. Frames with too few
    /// stars or a poor fit are ignored, and those that update() left out.
    void identified(int64_t stamp_ns, const st_centroid *centroids,
                    const st_identified *identified, int count, Arena &arena);

    /// Start tracks of stars that came into view in the last frame. The next update() calls it first.
    void acquire_new_stars(Arena &arena);

    /// Whether the stars of the newest frame agree on an attitude, and this is it.
    const TrackedAttitude *attitude() const;

    /// Fill in attitude, budget and motion of the newest frame: by the filter, or by its stars alone;
    /// not valid where there is none.
    void fill(st_attitude &attitude, st_budget &budget, Arena &arena);
    void fill_of_frame(st_attitude &attitude, st_budget &budget, Arena &arena);

    /// List where the brightest stars in view, tracked or not, are at the newest frame; false unless
    /// TRACKING with an attitude.
    bool predict(List<st_prediction> &predictions);

    /// List the tracks of the newest frame, none unless TRACKING.
    void publish(List<st_star_track> &tracks) const;

    /// state and reason describe the last transition; contradiction is why the stars of the newest
    /// frame are not an attitude although some agree; frames_since_fix counts the frames since the
    /// last good one, stars_matched its inliers, residual_px is their rms; late_frames counts
    /// those that were not newer, rejected_centroids those without a finite position or a positive
    /// sigma, checks_passed the identifications that agreed with the tracks.
    st_state state = ST_LOST;
    st_reason reason{}, contradiction{};
    double residual_px = NAN;
    int stars_matched = 0, frames_since_fix = 0;
    int late_frames = 0, rejected_centroids = 0, checks_passed = 0;

    Gyro gyro;
    HintedStart hints{};

    /// The model of one rotation.
    const AttitudeModel &model() const { return attitude_; }

    double stamp_sigma_s() const { return is_attitude() ? attitude_.stamp_sigma_s() : 0.0; }
    bool uses_gyro() const { return is_attitude() ? attitude_.uses_gyro() : stars_.uses_gyro; }
    const st_reason &gyro_trouble() const {
        return is_attitude() ? attitude_.gyro_trouble() : stars_.gyro_trouble;
    }

    static size_t bytes(const st_config &config, const TrackCapacities &capacities);
    static size_t work_bytes(const st_config &config, const TrackCapacities &capacities);

private:
    /// A frame that is kept for an identification that comes late.
    struct RecentFrame {
        int64_t stamp_ns;
        List<st_centroid> centroid;
        double exposure_s[2];
    };

    /// The centroids of the last good frame that are in no gate, and its attitude.
    struct NewStarSearch {
        bool is_due;
        TrackedAttitude attitude;
        double scale;
        List<st_centroid> free;
    };

    bool is_attitude() const { return options_.model == ST_ATTITUDE_MODEL; }
    TrackList &bank() { return is_attitude() ? bank_ : stars_.bank; }
    const TrackList &bank() const { return is_attitude() ? bank_ : stars_.bank; }
    Lens model_lens() const { return is_attitude() ? attitude_.lens() : lens_; }
    Vector3 rate_rad_s() const;
    Matrix3 rate_covariance() const;
    bool is_sparse(const CentroidFrame &frame) const { return frame.count < options_.min_stars; }
    bool gap_exceeded(int64_t stamp_ns, int64_t other_ns) const;

    CentroidFrame usable(const st_centroid *centroids, int count, const st_identified *identified,
                         int32_t *hip, Arena &arena);
    void remember(int64_t stamp_ns, const CentroidFrame &frame);

    void enter(st_state entered, const st_reason &why);
    void acquire(const IdentifiedFrame &frame, const st_reason &why);
    void start(const Start &begin, Arena &arena);
    void start_and_catch_up(const Start &begin, Arena &arena);
    void cross_check(const IdentifiedFrame &frame, Arena &arena);
    void seen_elsewhere(const IdentifiedFrame &frame, Arena &arena);

    void track(int64_t stamp_ns, const CentroidFrame &frame, Arena &arena);
    void update_model(int64_t stamp_ns, const CentroidFrame &frame, FrameUpdate &update,
                      Arena &arena);
    void end_good_frame(int64_t stamp_ns, const FrameUpdate &update, Arena &arena);
    void end_bad_frame(const CentroidFrame &frame);
    void keep_tracks(const FrameUpdate *update, bool sparse);
    st_reason contradiction_in(const FrameUpdate &update, Arena &arena);
    st_reason misplaced(const Quaternion &attitude, double faintest, double scale,
                        const CentroidFrame &frame, Arena &arena);
    double faintest_detected() const;
    void resume(int64_t stamp_ns, const CentroidFrame &frame, Arena &arena);
    bool predicted(st_hint &hint) const;
    bool crosses_fast(int64_t stamp_ns) const;
    bool are_seen(const CentroidFrame &frame) const;
    void find_new_stars(const Quaternion &attitude, const Matrix3 &covariance,
                        const CentroidFrame &frame, double scale, double zero,
                        List<NewStar> &found, Arena &arena);
    void add_track(int32_t star, const st_centroid &centroid, bool confirmed);
    MeasuredRoll measured_roll(int64_t from_ns, int64_t to_ns) const;
    bool fill_errors(const TrackedAttitude &own, st_budget &budget, st_attitude &filled,
                     Arena &arena);

    st_tracking_options options_{};
    Lens lens_{};
    ApparentSky *sky_ = nullptr;
    StarsInView view_{};
    AttitudeModel attitude_;
    StarModel stars_{};
    TrackList bank_;

    bool has_stamp_ = false;
    int64_t stamp_ns_ = 0, before_ns_ = 0, tracks_ns_ = 0, good_ns_ = 0;
    int bad_frames_ = 0;
    uint32_t next_id_ = 1;
    Repetition repetition_;
    RowPattern pattern_{};
    double seen_zero_point_ = NAN;
    bool has_seen_ = false;
    NewStarSearch search_{};

    // Rings, the oldest first.
    RecentFrame *recent_ = nullptr;
    TrackedAttitude *history_ = nullptr;
    int frames_ = 0, recents_ = 0, first_recent_ = 0, histories_ = 0, first_history_ = 0;

    IdentifiedFrame first_{}, elsewhere_{}, identified_{};
    bool has_first_ = false, has_elsewhere_ = false;
    Motion before_resume_{};
};

}  // namespace st
