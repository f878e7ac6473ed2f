// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "track/track_filter.h"

#include <algorithm>
#include <cmath>

#include "attitude/error_budget.h"
#include "attitude/pointing.h"
#include "attitude/results.h"
#include "integrity/checks.h"
#include "integrity/expected_stars.h"
#include "maths/sorting.h"
#include "maths/symmetric.h"
#include "track/prediction.h"
#include "track/systematic.h"

namespace st {
namespace {

using namespace checks;

constexpr double DEG = M_PI / 180;
constexpr double SILENCE_S = limit(GYRO_SILENT, "age_s");

double seconds(int64_t ns) {
    return static_cast<double>(ns) * 1e-9;
}

/// Whether position and errors of a centroid are finite, and its own errors positive.
bool is_usable(const st_centroid &one, double floor_px) {
    const Covariance2 error = error_of(one, floor_px * floor_px);
    return std::isfinite(one.u_px + one.v_px + one.delay_s) && std::isfinite(one.sigma_px) &&
           one.sigma_px > 0 && is_finite({one.cov_uu_px2, one.cov_uv_px2, one.cov_vv_px2}) &&
           determinant(error) > 0 && is_finite(correlated_error_of(one));
}

TrackedAttitude attitude_of(const IdentifiedFrame &frame) {
    return {frame.stamp_ns, frame.quaternion, frame.covariance, NAN, NAN, frame.star.count};
}

/// Return options by which a list of tracks has this capacity.
st_tracking_options with_capacity(st_tracking_options options, int tracks) {
    options.max_stars = tracks;
    return options;
}

}  // namespace

TrackFilter::TrackFilter(const st_config &config, const Lens &lens, ApparentSky &sky,
                         const TrackCapacities &capacities, Arena &arena)
    : options_(config.tracking), lens_(lens), sky_(&sky), frames_(capacities.frames) {
    const auto tracks = static_cast<size_t>(capacities.tracks);
    const auto centroids = static_cast<size_t>(capacities.centroids);
    const auto frames = static_cast<size_t>(capacities.frames);
    const auto rates = static_cast<size_t>(capacities.rates);
    gyro.start(gyro_model(config.gyro), arena.take<MeasuredRate>(rates), capacities.rates);
    start_view(lens, capacities.view, arena, view_);
    if (is_attitude()) {
        attitude_ = AttitudeModel(config, lens);
        bank_ = arena.list<Track>(tracks);
    } else {
        make_star_model(with_capacity(options_, capacities.tracks), lens, arena, stars_);
    }
    repetition_ = Repetition(capacities.centroids, arena);
    search_.free = arena.list<st_centroid>(centroids);
    recent_ = arena.take<RecentFrame>(frames);
    for (int k = 0; k < frames_; ++k) {
        recent_[k] = {0, arena.list<st_centroid>(centroids), {}};
    }
    history_ = arena.take<TrackedAttitude>(frames);
    first_ = frame_for(capacities.centroids, arena);
    elsewhere_ = frame_for(capacities.centroids, arena);
    identified_ = frame_for(capacities.centroids, arena);
    reset();
}

size_t TrackFilter::bytes(const st_config &config, const TrackCapacities &capacities) {
    const auto tracks = static_cast<size_t>(capacities.tracks);
    const auto centroids = static_cast<size_t>(capacities.centroids);
    const auto frames = static_cast<size_t>(capacities.frames);
    const auto rates = static_cast<size_t>(capacities.rates);
    const bool by_attitude = config.tracking.model == ST_ATTITUDE_MODEL;
    return Arena::padded<MeasuredRate>(rates) + stars_in_view_bytes(capacities.view) +
           (by_attitude ? Arena::padded<Track>(tracks)
                        : star_model_bytes(with_capacity(config.tracking, capacities.tracks))) +
           Arena::padded<Point>(centroids) + Arena::padded<st_centroid>(centroids) +
           Arena::padded<RecentFrame>(frames) + frames * Arena::padded<st_centroid>(centroids) +
           Arena::padded<TrackedAttitude>(frames) +
           3 * identified_frame_bytes(capacities.centroids);
}

size_t TrackFilter::work_bytes(const st_config &config, const TrackCapacities &capacities) {
    const int centroids = capacities.centroids, view = capacities.view;
    const auto n = static_cast<size_t>(capacities.tracks), m = static_cast<size_t>(centroids);
    const auto v = static_cast<size_t>(view);
    const st_tracking_options options = with_capacity(config.tracking, capacities.tracks);
    const size_t model =
        options.model == ST_ATTITUDE_MODEL
            ? AttitudeModel::work_bytes(capacities.tracks, centroids)
            : star_update_bytes(options, centroids) +
                  Arena::padded<std::byte>(star_update_work_bytes(options, centroids)) +
                  Arena::padded<st_centroid>(m);
    const size_t given = Arena::padded<st_centroid>(m) + Arena::padded<int32_t>(m);
    const size_t expected = Arena::padded<ExpectedStar>(v) + Arena::padded<Point>(m) +
                            Arena::padded<double>(m) + contradiction_bytes(view, centroids);
    const size_t found = Arena::padded<FreeCentroid>(m) + Arena::padded<NewStar>(m) +
                         match_new_stars_bytes(view, centroids) + Arena::padded<int32_t>(m) +
                         Arena::padded<double>(n);
    // They follow one another; their sum is enough.
    return given + model + row_fit_bytes(capacities.tracks) + expected + found +
           fit_identified_bytes(centroids) + lasting_errors_bytes(capacities.tracks);
}

void TrackFilter::reset() {
    has_stamp_ = false;
    repetition_.reset();
    recents_ = first_recent_ = 0;
    gyro.clear();
    hints = {};
    histories_ = first_history_ = 0;
    frames_since_fix = 0;
    enter(ST_LOST, reason_of(ST_REASON_WAITING, {}));
}

void TrackFilter::set_limits(const st_tracking_options &options) {
    options_ = options;
    attitude_.set_limits(options);
}

// --- frames and identifications, in any interleaving ---

Order TrackFilter::order(int64_t stamp_ns) const {
    if (!has_stamp_ || stamp_ns > stamp_ns_) {
        return Order::NEWER;
    }
    return seconds(stamp_ns_ - stamp_ns) <= limit(LATE_FRAME, "back_s") ? Order::LATE
                                                                        : Order::BACK;
}

bool TrackFilter::update(int64_t stamp_ns, const st_centroid *centroids, int count,
                         const double exposure_s[2], Arena &arena) {
    const Order order = this->order(stamp_ns);
    if (order == Order::LATE) {
        ++late_frames;
        return false;
    }
    if (order == Order::BACK) {
        const double back_s = seconds(stamp_ns_ - stamp_ns);
        reset();
        reason = reason_of(TIME_JUMP, {back_s});
    }
    CentroidFrame frame = usable(centroids, count, nullptr, nullptr, arena);
    frame.exposure_s[0] = exposure_s[0];
    frame.exposure_s[1] = exposure_s[1];
    const bool repeated = repetition_.add(frame);
    if (repeated) {
        frame = {frame.centroid, 0, {0.0, INFINITY}};
    }
    has_stamp_ = true;
    stamp_ns_ = stamp_ns;
    remember(stamp_ns, frame);
    ++frames_since_fix;
    if (has_first_ && gap_exceeded(first_.stamp_ns, stamp_ns)) {
        enter(ST_LOST, reason_of(SECOND_TOO_LATE, {options_.max_gap_s}));
    }
    if (state == ST_TRACKING && stamp_ns != tracks_ns_) {
        track(stamp_ns, frame, arena);
    }
    if (repeated && state == ST_TRACKING) {
        contradiction = reason_of(REPEATED_FRAME, {});
    } else if (repeated && state == ST_LOST) {
        reason = reason_of(REPEATED_FRAME, {});
    }
    return true;
}

void TrackFilter::identified(int64_t stamp_ns, const st_centroid *centroids,
                             const st_identified *identified, int count, Arena &arena) {
    for (int k = 0; k < recents_; ++k) {
        const RecentFrame &recent = recent_[(first_recent_ + k) % frames_];
        if (recent.stamp_ns == stamp_ns && recent.centroid.count == 0) {
            return;
        }
    }
    auto *hip = arena.take<int32_t>(static_cast<size_t>(count));
    const CentroidFrame frame = usable(centroids, count, identified, hip, arena);
    look(stamp_ns, *sky_);
    st_reason misfit{};
    if (!fit_identified(lens_, *sky_, options_, stamp_ns, frame.centroid, hip, frame.count,
                        identified_, misfit, arena)) {
        if (misfit.code != ST_NO_REASON && state == ST_LOST) {
            reason = misfit;
        }
        return;
    }
    Start start;
    if (state == ST_TRACKING) {
        cross_check(identified_, arena);
    } else if (start_of_hint(hints, identified_, options_.max_gap_s, start)) {
        start_and_catch_up(start, arena);
    } else if (!has_first_ || gap_exceeded(first_.stamp_ns, stamp_ns)) {
        acquire(identified_,
                reason_of(ST_REASON_FIRST, {static_cast<double>(identified_.star.count)}));
    } else if (stamp_ns > first_.stamp_ns) {
        start_and_catch_up(start_of_two(first_, identified_), arena);
    }
}

/// Return the centroids with finite position and positive sigma, with hip of these where identified
/// is given.
CentroidFrame TrackFilter::usable(const st_centroid *centroids, int count,
                                  const st_identified *identified, int32_t *hip, Arena &arena) {
    auto *good = arena.take<st_centroid>(static_cast<size_t>(count));
    int left = 0;
    for (int m = 0; m < count; ++m) {
        if (is_usable(centroids[m], options_.sigma_floor_px)) {
            if (identified != nullptr) {
                hip[left] = identified[m].hip;
            }
            good[left++] = centroids[m];
        }
    }
    rejected_centroids += count - left;
    return {good, left, {0.0, INFINITY}};
}

void TrackFilter::remember(int64_t stamp_ns, const CentroidFrame &frame) {
    RecentFrame &recent = recent_[(first_recent_ + recents_) % frames_];
    if (recents_ < frames_) {
        ++recents_;
    } else {
        first_recent_ = (first_recent_ + 1) % frames_;
    }
    recent.stamp_ns = stamp_ns;
    recent.exposure_s[0] = frame.exposure_s[0];
    recent.exposure_s[1] = frame.exposure_s[1];
    recent.centroid.clear();
    for (const st_centroid &one : frame) {
        recent.centroid.add(one);
    }
}

bool TrackFilter::gap_exceeded(int64_t stamp_ns, int64_t other_ns) const {
    return std::fabs(seconds(stamp_ns - other_ns)) > options_.max_gap_s;
}

// --- transitions ---

/// Enter a state without tracks.
void TrackFilter::enter(st_state entered, const st_reason &why) {
    if (entered == ST_LOST) {
        note_loss(histories_, hints);
        has_seen_ = false;
    }
    state = entered;
    reason = why;
    stars_matched = 0;
    residual_px = NAN;
    has_first_ = has_elsewhere_ = false;
    attitude_.clear();
    stars_.uses_gyro = false;
    stars_.gyro_trouble = {};
    bank().clear();
    search_.is_due = false;
    pattern_ = {};
    contradiction = {};
    before_ns_ = tracks_ns_ = good_ns_ = 0;
    bad_frames_ = 0;
    histories_ = first_history_ = 0;
}

/// Enter ACQUIRING with the first identified frame.
void TrackFilter::acquire(const IdentifiedFrame &frame, const st_reason &why) {
    enter(ST_ACQUIRING, why);
    copy_frame(frame, first_);
    has_first_ = true;
}

/// Enter TRACKING at an identified frame and process the frames since.
void TrackFilter::start_and_catch_up(const Start &begin, Arena &arena) {
    const int64_t stamp_ns = begin.frame->stamp_ns;
    start(begin, arena);
    for (int k = 0; k < recents_ && state == ST_TRACKING; ++k) {
        const RecentFrame &recent = recent_[(first_recent_ + k) % frames_];
        if (recent.stamp_ns > stamp_ns) {
            const Arena::Scope scope(arena);
            track(recent.stamp_ns,
                  {recent.centroid.item,
                   recent.centroid.count,
                   {recent.exposure_s[0], recent.exposure_s[1]}},
                  arena);
        }
    }
}

/// Enter TRACKING at an identified frame.
void TrackFilter::start(const Start &begin, Arena &arena) {
    const IdentifiedFrame &frame = *begin.frame;
    const double rate_deg_s = norm(begin.rate_rad_s) / DEG;
    if (rate_deg_s > options_.max_rate_deg_s) {
        acquire(frame, reason_of(START_RATE, {rate_deg_s}));
        return;
    }
    enter(ST_TRACKING, begin.reason);
    note_start(begin.hinted, hints);
    if (is_attitude()) {
        attitude_.start(begin, gyro);
    } else {
        start_stars(begin, measured_roll(frame.stamp_ns - 1, frame.stamp_ns), stars_);
    }
    view_.lens = model_lens();
    for (int k = 0; k < frame.star.count && k < options_.max_stars; ++k) {
        add_track(frame.star[k], frame.centroid[k], true);
    }
    has_seen_ = true;
    seen_zero_point_ = zero_point(bank(), *sky_->file, arena);
    tracks_ns_ = good_ns_ = frame.stamp_ns;
    stars_matched = frame.star.count;
    frames_since_fix = 0;
    history_[0] = attitude_of(frame);
    histories_ = 1;
}

/// Compare an identified frame with the tracked attitude of its time, if there is one.
void TrackFilter::cross_check(const IdentifiedFrame &frame, Arena &arena) {
    for (int k = 0; k < histories_; ++k) {
        const TrackedAttitude &tracked = history_[(first_history_ + k) % frames_];
        if (tracked.stamp_ns != frame.stamp_ns) {
            continue;
        }
        if (contradicts(frame, tracked.quaternion, tracked.covariance, lens_, *sky_,
                        options_.max_residual_px)) {
            const double error_deg =
                norm(attitude_error(frame.quaternion, tracked.quaternion)) / DEG;
            acquire(frame, reason_of(IDENTIFICATION_DIFFERS, {error_deg}));
        } else {
            ++checks_passed;
        }
        return;
    }
    if (frame.stamp_ns > good_ns_ && bad_frames_ > 0) {
        seen_elsewhere(frame, arena);
    }
}

/// Start again at the second identified frame in a row that is not used: the body jumped.
void TrackFilter::seen_elsewhere(const IdentifiedFrame &frame, Arena &arena) {
    std::swap(first_, elsewhere_);
    const bool had_first = has_elsewhere_;
    copy_frame(frame, elsewhere_);
    has_elsewhere_ = true;
    if (had_first && first_.stamp_ns < frame.stamp_ns) {
        Start begin = start_of_two(first_, elsewhere_);
        begin.reason = reason_of(STARS_ELSEWHERE, {static_cast<double>(bad_frames_),
                                                   static_cast<double>(frame.star.count)});
        start_and_catch_up(begin, arena);
    }
}

// --- from frame to frame ---

/// Update the tracks by a newer frame.
void TrackFilter::track(int64_t stamp_ns, const CentroidFrame &frame, Arena &arena) {
    if (gap_exceeded(stamp_ns, good_ns_)) {
        enter(ST_LOST, reason_of(NO_STARS, {seconds(stamp_ns - good_ns_)}));
    }
    if (stamp_ns <= tracks_ns_ || state != ST_TRACKING) {
        return;
    }
    acquire_new_stars(arena);
    before_ns_ = tracks_ns_;
    tracks_ns_ = stamp_ns;
    look(stamp_ns, *sky_);
    FrameUpdate update;
    update_model(stamp_ns, frame, update, arena);
    view_.lens = model_lens();
    if (is_attitude() && attitude_.failure().code != ST_NO_REASON) {
        enter(ST_LOST, attitude_.failure());
        return;
    }
    contradiction = update.good ? contradiction_in(update, arena) : st_reason{};
    stars_matched = update.has_fit ? update.inliers : 0;
    residual_px = update.has_fit ? update.residual_px : NAN;
    if (update.has_fit && update.good) {
        end_good_frame(stamp_ns, update, arena);
    } else {
        const bool sparse = is_sparse(update.frame);
        end_bad_frame(update.frame);
        if (state == ST_TRACKING && !sparse) {
            resume(stamp_ns, update.frame, arena);
        }
    }
}

void TrackFilter::update_model(int64_t stamp_ns, const CentroidFrame &frame, FrameUpdate &update,
                               Arena &arena) {
    if (is_attitude()) {
        attitude_.update(stamp_ns, frame, *sky_, gyro, bank_, update, arena);
        return;
    }
    StarUpdate done{};
    const size_t bytes =
        star_update_work_bytes(with_capacity(options_, bank().capacity), frame.count);
    Arena work(arena.take<std::byte>(bytes), bytes);
    update_stars(stamp_ns, frame.centroid, frame.count, measured_roll(stars_.stamp_ns, stamp_ns),
                 *sky_, options_, stars_, done, arena, work);
    update = {};
    update.good = done.good;
    update.has_fit = done.has_fit;
    update.quaternion = done.fit.attitude.quaternion;
    update.covariance = done.fit.attitude.covariance;
    update.inliers = done.fit.attitude.stars;
    update.residual_px = done.fit.residual_px;
    update.chi2 = done.fit.attitude.chi2;
    update.scale = done.fit.scale;
    update.normalised = done.fit.normalised;
    update.unassociated = done.unassociated;
    auto *moved = arena.take<st_centroid>(static_cast<size_t>(frame.count));
    for (int m = 0; m < frame.count; ++m) {
        moved[m] = frame.centroid[m];
        moved[m].u_px = done.uv[m].x;
        moved[m].v_px = done.uv[m].y;
    }
    update.frame = {moved, frame.count, {frame.exposure_s[0], frame.exposure_s[1]}};
}

/// Return why not all of a frame shows the attitude that was found.
st_reason TrackFilter::contradiction_in(const FrameUpdate &update, Arena &arena) {
    const st_reason why =
        misplaced(update.quaternion, faintest_detected(), update.scale, update.frame, arena);
    if (why.code != ST_NO_REASON || !update.has_residuals) {
        return why;
    }
    return find_pattern(lens_, update.detected.item, update.detected.count, pattern_, arena);
}

double TrackFilter::faintest_detected() const {
    double faintest = -HUGE_VAL;
    for (const Track &track : bank()) {
        if (track.is_detected()) {
            faintest = std::fmax(faintest, sky_->file->magnitude[track.star]);
        }
    }
    return faintest;
}

/// Return what contradicts an attitude among the stars up to a magnitude.
st_reason TrackFilter::misplaced(const Quaternion &attitude, double faintest, double scale,
                                 const CentroidFrame &frame, Arena &arena) {
    const Arena::Scope scope(arena);
    const auto count = static_cast<size_t>(frame.count);
    auto *uv = arena.take<Point>(count);
    auto *sigma_px = arena.take<double>(count);
    for (int m = 0; m < frame.count; ++m) {
        uv[m] = {frame.centroid[m].u_px, frame.centroid[m].v_px};
        sigma_px[m] = sigma_of(frame.centroid[m], options_.sigma_floor_px);
    }
    const double present_px =
        std::fmax(limit(SECOND_IMAGE, "present_px"),
                  sigmas(STAR_OUTLIER) * scale * median(sigma_px, frame.count));
    List<ExpectedStar> expected =
        arena.list<ExpectedStar>(static_cast<size_t>(view_.near.capacity));
    visible_stars(*sky_, attitude, rate_rad_s(), faintest, view_, expected);
    return contradiction_of(expected.item, expected.count, uv, frame.count, present_px, arena);
}

/// Record the attitude, drop missed, blended and outlying stars, confirm new ones.
void TrackFilter::end_good_frame(int64_t stamp_ns, const FrameUpdate &update, Arena &arena) {
    bad_frames_ = 0;
    good_ns_ = stamp_ns;
    has_elsewhere_ = false;
    const TrackedAttitude attitude{stamp_ns,    update.quaternion,  update.covariance,
                                   update.chi2, update.residual_px, update.inliers};
    if (contradiction.code == ST_NO_REASON) {
        frames_since_fix = 0;
        history_[(first_history_ + histories_) % frames_] = attitude;
        if (histories_ < frames_) {
            ++histories_;
        } else {
            first_history_ = (first_history_ + 1) % frames_;
        }
    }
    keep_tracks(&update, is_sparse(update.frame));
    has_seen_ = true;
    seen_zero_point_ = zero_point(bank(), *sky_->file, arena);
    search_ = {true, attitude, update.scale, search_.free};
    search_.free.clear();
    for (int m = 0; m < update.frame.count; ++m) {
        if (update.unassociated[m]) {
            search_.free.add(update.frame.centroid[m]);
        }
    }
}

/// Drop missed stars, and enter LOST after max_bad_frames.
void TrackFilter::end_bad_frame(const CentroidFrame &frame) {
    // A sparse frame is not evidence against the tracks.
    const bool sparse = is_sparse(frame);
    bad_frames_ += sparse ? 0 : 1;
    keep_tracks(nullptr, sparse);
    if (bad_frames_ >= options_.max_bad_frames) {
        enter(ST_LOST, reason_of(BAD_FRAMES, {static_cast<double>(bad_frames_),
                                              static_cast<double>(stars_matched), residual_px}));
    }
}

/// Keep the tracks that are not missed too often, after a good frame not outlying, and confirm new
/// ones.
void TrackFilter::keep_tracks(const FrameUpdate *update, bool sparse) {
    const double most_missed = sparse ? HUGE_VAL : options_.max_missed;
    TrackList &tracks = bank();
    int left = 0;
    for (int n = 0; n < tracks.count; ++n) {
        Track track = tracks[n];
        bool kept = is_kept(track, is_crowded(*sky_, track.star), most_missed);
        if (update != nullptr) {
            kept = kept && is_kept_after_fit(track, update->normalised[n], sigmas(STAR_OUTLIER));
            confirm(track, options_.confirm_frames);
        }
        if (kept) {
            tracks[left++] = track;
        }
    }
    tracks.count = left;
}

// --- other stars than those followed ---

/// Start again by other stars than those followed, where enough are as predicted.
///
/// Only in a fast turn, where faint stars leave the image before as many new ones count. Where those
/// followed are seen and do not agree, the motion is not as predicted.
void TrackFilter::resume(int64_t stamp_ns, const CentroidFrame &frame, Arena &arena) {
    st_hint hint;
    if (!has_seen_ || !crosses_fast(stamp_ns) || are_seen(frame) || !predicted(hint)) {
        return;
    }
    List<NewStar> found = arena.list<NewStar>(static_cast<size_t>(frame.count));
    find_new_stars(quaternion_of(hint.quaternion), matrix_of(hint.covariance_rad2), frame, 1.0,
                   seen_zero_point_, found, arena);
    auto *hip = arena.take<int32_t>(static_cast<size_t>(frame.count));
    std::fill_n(hip, frame.count, 0);
    for (const NewStar &one : found) {
        hip[one.centroid] = sky_->file->hip[one.star];
    }
    st_reason misfit{};
    if (!fit_identified(lens_, *sky_, options_, stamp_ns, frame.centroid, hip, frame.count,
                        identified_, misfit, arena)) {
        return;
    }
    double faintest = -HUGE_VAL;
    for (const int32_t star : identified_.star) {
        faintest = std::fmax(faintest, sky_->file->magnitude[star]);
    }
    Start begin;
    if (misplaced(identified_.quaternion, faintest, identified_.scale, frame, arena).code !=
            ST_NO_REASON ||
        !start_of_prediction(hint, identified_, begin)) {
        return;
    }
    if (is_attitude()) {
        before_resume_ = attitude_.motion();
    }
    start(begin, arena);
    if (is_attitude() && state == ST_TRACKING) {
        attitude_.resume(before_resume_);
    }
}

/// Fill in the attitude that predicts the next frame; false without one.
bool TrackFilter::predicted(st_hint &hint) const {
    if (is_attitude()) {
        return attitude_.predicted(hint);
    }
    const TrackedAttitude *now = attitude();
    if (now != nullptr) {
        hint.stamp_ns = now->stamp_ns;
        set(now->quaternion, hint.quaternion);
        set(stars_.rate_rad_s, hint.rate_rad_s);
        set(now->covariance, hint.covariance_rad2);
        set(stars_.rate_covariance, hint.rate_covariance);
    }
    return now != nullptr;
}

/// Whether stars leave the image within some frames of this interval.
bool TrackFilter::crosses_fast(int64_t stamp_ns) const {
    const Vector3 rate = rate_rad_s();
    const double moved_px =
        std::hypot(rate[0], rate[1]) * lens_.fx * seconds(stamp_ns - before_ns_);
    return moved_px > limit(FAST_TURN, "width_share") * lens_.width;
}

/// Whether enough of the stars followed have a centroid in the neighbourhood.
bool TrackFilter::are_seen(const CentroidFrame &frame) const {
    int seen = 0;
    for (const Track &track : bank()) {
        const Point at = track.uv();
        double away_px = INFINITY;
        for (const st_centroid &one : frame) {
            away_px = std::fmin(away_px, std::hypot(at.x - one.u_px, at.y - one.v_px));
        }
        seen += track.confirmed && away_px < limit(FAST_TURN, "neighbourhood_px") ? 1 : 0;
    }
    return seen >= options_.min_stars;
}

/// List catalogue stars among centroids by an attitude, with scale times their sigma.
void TrackFilter::find_new_stars(const Quaternion &attitude, const Matrix3 &covariance,
                                 const CentroidFrame &frame, double scale, double zero,
                                 List<NewStar> &found, Arena &arena) {
    auto *free = arena.take<FreeCentroid>(static_cast<size_t>(frame.count));
    for (int m = 0; m < frame.count; ++m) {
        const st_centroid &one = frame.centroid[m];
        free[m] = {
            m, {one.u_px, one.v_px}, one.flux_dn, scale * sigma_of(one, options_.sigma_floor_px)};
    }
    match_new_stars(*sky_, attitude, covariance, lens_, free, frame.count, zero,
                    options_.magnitude_tolerance, view_, found, arena);
}

void TrackFilter::acquire_new_stars(Arena &arena) {
    if (!search_.is_due) {
        return;
    }
    search_.is_due = false;
    TrackList &tracks = bank();
    const int most = std::min(options_.max_stars, tracks.capacity);
    if (tracks.count >= most || search_.free.count == 0) {
        return;
    }
    const Arena::Scope scope(arena);
    look(tracks_ns_, *sky_);
    const CentroidFrame frame{search_.free.item, search_.free.count, {}};
    List<NewStar> found = arena.list<NewStar>(static_cast<size_t>(frame.count));
    find_new_stars(search_.attitude.quaternion, search_.attitude.covariance, frame, search_.scale,
                   zero_point(tracks, *sky_->file, arena), found, arena);
    for (const NewStar &one : found) {
        if (tracks.count < most && !has_star(tracks, one.star)) {
            add_track(one.star, frame.centroid[one.centroid], false);
        }
    }
}

/// Add a track of a star at a centroid, which moves with the body rate.
void TrackFilter::add_track(int32_t star, const st_centroid &centroid, bool confirmed) {
    const uint32_t track_id = next_id_++;
    if (!is_attitude()) {
        add_star(track_id, star, centroid, confirmed, options_, stars_);
        return;
    }
    const double sigma_px = sigma_of(centroid, options_.sigma_floor_px);
    Track track = started_track(track_id, star, centroid, sigma_px * sigma_px, confirmed);
    moved_by(lens_, {centroid.u_px, centroid.v_px}, sigma_px * sigma_px, rate_rad_s(),
             rate_covariance(), track.state, track.covariance);
    bank_.add(track);
}

/// Return the mean roll rate between two times by a gyro, where the options ask for it.
MeasuredRoll TrackFilter::measured_roll(int64_t from_ns, int64_t to_ns) const {
    if (options_.roll_by_gyro == 0 || gyro.silent_s(to_ns) > SILENCE_S) {
        return {false, 0.0, 0.0};
    }
    return {true, gyro.mean_rate(from_ns, to_ns).rate_rad_s[2], gyro.model.noise_density};
}

// --- results ---

Vector3 TrackFilter::rate_rad_s() const {
    return is_attitude() ? attitude_.rate_rad_s() : stars_.rate_rad_s;
}

Matrix3 TrackFilter::rate_covariance() const {
    return is_attitude() ? attitude_.rate_covariance() : stars_.rate_covariance;
}

const TrackedAttitude *TrackFilter::attitude() const {
    if (histories_ == 0 || !has_stamp_) {
        return nullptr;
    }
    const TrackedAttitude &newest = history_[(first_history_ + histories_ - 1) % frames_];
    return newest.stamp_ns == stamp_ns_ ? &newest : nullptr;
}

void TrackFilter::fill(st_attitude &filled, st_budget &budget, Arena &arena) {
    set_unknown(filled);
    budget = {};
    const TrackedAttitude *now = attitude();
    if (now == nullptr) {
        return;
    }
    if (is_attitude()) {
        budget = attitude_.budget(now->covariance, false);
    } else {
        set(now->covariance, budget.stars);
    }
    if (!fill_errors(*now, budget, filled, arena)) {
        return;
    }
    filled.chi2 = now->chi2;
    filled.residual_px = now->residual_px;
    set(rate_rad_s(), filled.rate_rad_s);
    set(rate_covariance(), filled.rate_covariance);
    Course course{};
    if (is_attitude()) {
        set(attitude_.cross_covariance(), filled.cross_covariance);
        course = attitude_.course();
    } else {
        const double across = DEG * options_.acceleration_deg_s2;
        course.sigma_rad_s2 = {{across, across, DEG * options_.roll_acceleration_deg_s2}};
    }
    set(course.acceleration_rad_s2, filled.acceleration_rad_s2);
    set(course.jerk_rad_s3, filled.jerk_rad_s3);
    set(course.sigma_rad_s2, filled.acceleration_sigma_rad_s2);
    set(course.sigma_before_rad_s2, filled.acceleration_sigma_before_rad_s2);
}

void TrackFilter::fill_of_frame(st_attitude &filled, st_budget &budget, Arena &arena) {
    set_unknown(filled);
    budget = {};
    const TrackedAttitude *now = attitude();
    if (now == nullptr || !is_attitude() || !attitude_.has_measured()) {
        return;
    }
    TrackedAttitude own = *now;
    own.quaternion = attitude_.measured_quaternion();
    budget = attitude_.budget(attitude_.measured_covariance(), true);
    fill_errors(own, budget, filled, arena);
}

/// Add the errors that last to a budget, and fill in the attitude with their sum. False where it
/// has no covariance: of one star that is left they may have any effect.
bool TrackFilter::fill_errors(const TrackedAttitude &own, st_budget &budget, st_attitude &filled,
                              Arena &arena) {
    look(tracks_ns_, *sky_);
    const LastingErrors lasting = is_attitude() ? attitude_.lasting_errors() : LastingErrors{};
    add_lasting_errors(lens_, bank(), *sky_->file, lasting, &sky_->observer, own.quaternion,
                       budget, arena);
    const Matrix3 covariance = covariance_of(budget);
    if (!is_positive_definite(covariance)) {
        return false;
    }
    filled.valid = 1;
    filled.stamp_ns = own.stamp_ns;
    filled.stars = own.stars;
    set(own.quaternion, filled.quaternion);
    set(covariance, filled.covariance_rad2);
    return true;
}

bool TrackFilter::predict(List<st_prediction> &predictions) {
    predictions.clear();
    if (state != ST_TRACKING || !has_stamp_ || tracks_ns_ != stamp_ns_) {
        return false;
    }
    st_hint hint;
    if (!is_attitude() && attitude() == nullptr) {
        return false;
    }
    // After a jump there is an attitude that predicts no star.
    if (predicted(hint)) {
        look(tracks_ns_, *sky_);
        const int most = static_cast<int>(SPARE_STARS * options_.max_stars);
        List<st_prediction> brightest = predictions;
        brightest.capacity = std::min(predictions.capacity, most);
        predict_stars(*sky_, quaternion_of(hint.quaternion), matrix_of(hint.covariance_rad2),
                      vector_of(hint.rate_rad_s), options_.magnitude_limit, view_, brightest);
        predictions.count = brightest.count;
    }
    return true;
}

void TrackFilter::publish(List<st_star_track> &tracks) const {
    tracks.clear();
    if (state != ST_TRACKING || !has_stamp_ || stamp_ns_ != tracks_ns_) {
        return;
    }
    const bool identified = good_ns_ == tracks_ns_ && contradiction.code == ST_NO_REASON;
    tracks.count = st::publish(bank(), *sky_->file, identified, tracks.item, tracks.capacity);
    tracks.left_out = std::max(bank().count - tracks.count, 0);
    const TrackedAttitude *now = attitude();
    if (now == nullptr) {
        return;
    }
    const Matrix3 R = matrix_from_quaternion(now->quaternion);
    for (int n = 0; n < tracks.count; ++n) {
        const Point at =
            project(lens_, sensor_direction(R, apparent_direction(*sky_, bank()[n].star)));
        tracks[n].distance_px = std::hypot(tracks[n].u_px - at.x, tracks[n].v_px - at.y);
    }
}

}  // namespace st
