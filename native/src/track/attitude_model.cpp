// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "track/attitude_model.h"

#include <algorithm>
#include <cmath>

#include "attitude/error_budget.h"
#include "attitude/pointing.h"
#include "attitude/results.h"
#include "integrity/checks.h"
#include "maths/symmetric.h"
#include "track/followed_stars.h"
#include "track/rolling_shutter.h"

namespace st {
namespace {

using namespace checks;

/// Length of a streak from which on a fit sees rather its ends; computed for a width of 1 px.
constexpr double STREAK_PX = 15.0;
constexpr double LINE_TIME_SIGMA = 0.1, LEAST_LINE_TIME_SIGMA = 0.0003;  // first frame, later
constexpr double ACROSS = 0.03;  // of a jump: the same across it, as the direction is not certain
constexpr double UNSEEN = 0.02;  // share of the flux of a star that is elsewhere and does not show
constexpr double SILENCE_S = limit(GYRO_SILENT, "age_s");
constexpr int SHEARED = static_cast<int>(limit(SHEARED_STARS, "stars"));
/// Of the mixture, of the gyro alone, and of each of the wide modes.
constexpr int HYPOTHESES = 2 + static_cast<int>(sizeof WIDE / sizeof WIDE[0]);
/// A correction for each, and one more from there.
constexpr int MOST_CORRECTIONS = 2 * HYPOTHESES;

double radians(double degrees) {
    return degrees * (M_PI / 180);
}

template <int N>
double square(const Vector<N> &v) {
    return dot(v, v);
}

Matrix3 outer(const Vector3 &a, const Vector3 &b) {
    Matrix3 product;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            product[i][j] = a[i] * b[j];
        }
    }
    return product;
}

template <int N>
Matrix3 block(const Matrix<N, N> &P, int row, int column) {
    Matrix3 part;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            part[i][j] = P[row + i][column + j];
        }
    }
    return part;
}

template <int N>
void add_block(const Matrix3 &part, int at, Matrix<N, N> &P) {
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            P[at + i][at + j] += part[i][j];
        }
    }
}

/// Return P^-1 v.
Vector3 divided(const Vector3 &v, const Matrix3 &P) {
    return inverse(P) * v;
}

/// Let the attitudes of all modes have another error.
void add_turn_error(const Matrix3 &error, Motion &motion) {
    for (ModeState<0> &mode : motion.mode) {
        add_block(error, TURN, mode.covariance);
    }
}

/// Return the size of a turn across a rate: along it an error of time turns.
double across(const Vector3 &moved, const Vector3 &rate_rad_s) {
    return norm(cross(moved, scaled(rate_rad_s, 1 / std::fmax(norm(rate_rad_s), 1e-12))));
}

/// Whether the body turns as before a jump.
bool is_displaced(const Jump &jump, const Vector3 &rate_rad_s, const Matrix3 &rate_covariance) {
    Vector3 change;
    for (int axis = 0; axis < 3; ++axis) {
        change[axis] = rate_rad_s[axis] - jump.rate_rad_s[axis];
    }
    return jump.left > 0 && dot(change, divided(change, rate_covariance)) < DISPLACED.threshold;
}

/// Return the variance of a jump at the very beginning or end of an exposure, of a body that jumps
/// in a share of the frames.
double unseen_variance(const Jump &jump, double share) {
    const double tail = tail_sigmas(share * UNSEEN, MISSED_LIGHT);
    const double size = UNSEEN * across(jump.moved_rad, jump.rate_rad_s);
    const double sigma = tail != 0 ? size / (WRONG_SIGMAS - tail) : 0.0;
    return sigma * sigma;
}

// --- the error scale ---

/// Add medians of the residuals of a good frame as of Correction, over sigma times value. is_floor is
/// whether some sigma is the least one that is assumed, which stays as it is.
void add_frame(double typical, double precise, bool is_floor, ErrorScale &scale) {
    const double size = scale.value / RAYLEIGH_MEDIAN;
    scale.frames = std::min(scale.frames + 1, static_cast<int>(ERROR_SCALE.frames));
    scale.ratio += (size * typical - scale.ratio) / scale.frames;
    scale.precise += ((is_floor ? 1.0 : size * precise) - scale.precise) / scale.frames;
    const double largest = std::fmax(scale.ratio, scale.precise);
    scale.value = 1.0;
    if (scale.ratio > limit(ERROR_SCALE, "large")) {
        scale.value = scale.ratio;
    } else if (largest < limit(ERROR_SCALE, "small") && scale.frames == ERROR_SCALE.frames) {
        scale.value = std::fmax(largest, limit(ERROR_SCALE, "least"));
    }
}

}  // namespace

AttitudeModel::AttitudeModel(const st_config &config, const Lens &lens)
    : options_(config.tracking),
      lens_(lens),
      pixel_rad_(pixel_angle(lens)),
      detection_(detection_model(config.tracking, lens)) {
    const double across_rad_s2 = radians(options_.acceleration_deg_s2);
    const GyroModel gyro = gyro_model(config.gyro);
    noise_ = {{{across_rad_s2, across_rad_s2, radians(options_.roll_acceleration_deg_s2)}},
              {{gyro.drift_density, gyro.drift_density, gyro.drift_density}}};
    drift_sigma_rad_s_ = gyro.drift_sigma_rad_s;
    clear();
}

void AttitudeModel::clear() {
    uses_gyro_ = has_measured_ = false;
    correlated_ = {};
    shutter_rad_ = {};
    frames_ = diverged_ = 0;
    jump_ = {};
    agreement_ = {};
    jitter_ = start_jitter();
    lens_error_ = {};
    gyro_trouble_ = failure_ = {};
}

void AttitudeModel::start(const Start &start, const Gyro &gyro) {
    clear();
    const IdentifiedFrame &frame = *start.frame;
    const double scale2 = frame.scale * frame.scale;
    state_ = {};
    state_.stamp_ns = frame.stamp_ns;
    state_.quaternion = frame.quaternion;
    state_.rate_rad_s = start.rate_rad_s;
    bool has_cross = false;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            state_.covariance[i][j] = frame.covariance[i][j] * scale2;
            state_.covariance[i][3 + j] = state_.covariance[3 + j][i] = start.cross[i][j];
            state_.covariance[3 + i][3 + j] = start.rate_covariance[i][j];
            has_cross = has_cross || start.cross[i][j] != 0;
        }
    }
    state_ = with_new_drift(state_, gyro.model.drift_sigma_rad_s);
    scale_ = {frame.scale, frame.scale, frame.scale, 1};
    const Matrix<9, 9> &P = state_.covariance;
    start_motion(state_, nullptr, {{P[0][0], P[1][1], P[2][2]}},
                 has_cross ? P[0][0] / start.cross[0][0] : 0.0, next_);
    set_motion(false);
}

void AttitudeModel::resume(const Motion &before) {
    resume_motion(before, motion_);
    interrupt_motion(motion_);
}

// --- a frame: predict, associate, update, check ---

/// Update by the first hypothesis that the stars confirm, or keep the nominal one.
void AttitudeModel::update(int64_t stamp_ns, const CentroidFrame &frame, const ApparentSky &sky,
                           const Gyro &gyro, TrackList &bank, FrameUpdate &update, Arena &arena) {
    // Of steps whose results stay in the arena.
    const size_t bytes = correction_work_bytes(bank.count, frame.count);
    Arena work(arena.take<std::byte>(bytes), bytes);
    const Measured measured = this->measured(stamp_ns, frame, sky, bank, arena, work);
    if (motion_.interval_s == 0) {
        motion_.interval_s = static_cast<double>(stamp_ns - motion_.stamp_ns) * 1e-9;
    }
    update = {};
    Explanation nominal, confirmed;
    explain(measured, gyro, nominal, confirmed, arena);
    if (confirmed.any) {
        use(confirmed, measured, gyro, bank, update, arena);
    } else {
        go_without(nominal, measured, gyro, bank, update, arena);
    }
}

/// Find the first hypothesis that the stars contradict, and the first one that they confirm.
void AttitudeModel::explain(const Measured &measured, const Gyro &gyro, Explanation &nominal,
                            Explanation &confirmed, Arena &arena) {
    const bool with_gyro = uses_gyro_ && gyro.silent_s(measured.stamp_ns) <= SILENCE_S &&
                           (measured.sparse || !is_saturated(measured.stamp_ns, gyro));
    for (int number = 0; number < HYPOTHESES; ++number) {
        Explanation tried;
        if (!hypothesis(number, with_gyro, measured, gyro, tried.hypothesis)) {
            continue;
        }
        tried.any = true;
        tried.correction = corrected(tried.hypothesis, measured, arena);
        const Correction first = tried.correction;
        if (!is_consistent(first, tried.hypothesis.gate)) {
            if (!nominal.any) {
                nominal = tried;
            }
            if (measured.sparse) {
                break;
            }
            continue;
        }
        if (square(first.innovation) > LIKELY_INNOVATION.threshold) {
            // Far from the prediction gates are wide: the stars are associated again from here.
            Hypothesis nearer = tried.hypothesis;
            nearer.state = first.state;
            const Correction again = corrected(nearer, measured, arena);
            if (again.agreed) {
                tried.hypothesis = nearer;
                tried.correction = again;
            }
        }
        if (confirmed.any && first.inliers < confirmed.correction.inliers + SHEARED) {
            continue;
        }
        if (!nominal.any) {
            nominal = confirmed;
        }
        confirmed = tried;
        if (!measured.rolling || first.stars - first.inliers < SHEARED) {
            break;
        }
    }
}

// --- predict ---

/// Make the nominal prediction, that of the gyro alone, then those of jumps; false for none of a
/// number.
bool AttitudeModel::hypothesis(int number, bool with_gyro, const Measured &measured,
                               const Gyro &gyro, Hypothesis &made) {
    const int64_t stamp_ns = measured.stamp_ns;
    if (number == 0) {
        predict(stamp_ns, with_gyro, gyro, predicted_[0]);
        // Of another motion than before the modes know less than the gyro, which integrates it. In a
        // sparse frame no assumption about the acceleration holds.
        const bool goes_on =
            predicted_[0].weight[most_probable_mode(motion_.weight)] > MOTION_ENDS.probability;
        made = {with_gyro, state_of(predicted_[0]), &predicted_[0], INNOVATION.threshold};
        return !with_gyro || (goes_on && !measured.sparse);
    }
    if (number == 1) {
        if (with_gyro) {
            made = {true, gyro.propagated(state_, stamp_ns), nullptr, INNOVATION.threshold};
        }
        return with_gyro;
    }
    Motion &motion = predicted_[with_gyro ? 1 : 0];
    if (with_gyro && number == 2) {
        predict(stamp_ns, false, gyro, motion);
    }
    const bool is_widest = number == HYPOTHESES - 1;
    made = {false, state_of(motion, weights_of(motion.weight, WIDE[number - 2])), &motion,
            is_widest ? INNOVATION.threshold : LIKELY_INNOVATION.threshold};
    return true;
}

/// Fill in the motion at a time, by the rates of the gyro or without.
void AttitudeModel::predict(int64_t stamp_ns, bool with_gyro, const Gyro &gyro,
                            Motion &motion) const {
    const GyroRates rates =
        with_gyro ? gyro.rates(motion_.stamp_ns, stamp_ns)
                  : no_rates(static_cast<double>(stamp_ns - motion_.stamp_ns) * 1e-9);
    predict_motion(motion_, stamp_ns, rates, noise_, motion);
}

bool AttitudeModel::is_saturated(int64_t stamp_ns, const Gyro &gyro) const {
    return gyro.is_saturated(stamp_ns, SILENCE_S);
}

// --- associate ---

AttitudeModel::Measured AttitudeModel::measured(int64_t stamp_ns, const CentroidFrame &frame,
                                                const ApparentSky &sky, const TrackList &bank,
                                                Arena &arena, Arena &work) const {
    const auto tracks = static_cast<size_t>(bank.count), count = static_cast<size_t>(frame.count);
    auto *icrf = arena.take<Vector3>(tracks);
    auto *confirmed = arena.take<bool>(tracks);
    for (int n = 0; n < bank.count; ++n) {
        icrf[n] = apparent_direction(sky, bank[n].star);
        confirmed[n] = bank[n].confirmed;
    }
    auto *variance = arena.take<double>(count);
    auto *error = arena.take<Covariance2>(count);
    auto *scaled_error = arena.take<Covariance2>(count);
    auto *delay_s = arena.take<double>(count);
    const double floor_px = options_.sigma_floor_px, scale2 = scale_.value * scale_.value;
    for (int m = 0; m < frame.count; ++m) {
        const st_centroid &one = frame.centroid[m];
        const double sigma_px = scale_.value * sigma_of(one, floor_px);
        variance[m] = sigma_px * sigma_px;
        error[m] = error_of(one, floor_px * floor_px);
        scaled_error[m] = {scale2 * error[m].uu, scale2 * error[m].uv, scale2 * error[m].vv};
        delay_s[m] = one.delay_s;
    }
    Measured made{};
    made.sky = sky.file;
    made.work = &work;
    made.tracks = bank.count;
    made.stamp_ns = stamp_ns;
    made.frame = frame;
    made.sparse = frame.count < options_.min_stars;
    made.rolling = is_rolling(frame);
    made.icrf = icrf;
    made.confirmed = confirmed;
    made.variance = variance;
    made.error = error;
    made.scaled = scaled_error;
    made.delay_s = made.rolling ? delay_s : nullptr;
    Covariance2 correlated;
    made.has_correlated = correlated_error(frame.centroid, frame.count, correlated);
    if (made.has_correlated) {
        made.correlated = pointing_covariance(lens_, correlated, &state_.rate_rad_s);
    }
    return made;
}

/// Return a predicted state corrected by a frame.
Correction AttitudeModel::corrected(const Hypothesis &hypothesis, const Measured &measured,
                                    Arena &arena) const {
    AttitudeState predicted = hypothesis.state;
    if (measured.has_correlated) {
        add_block(measured.correlated, 0, predicted.covariance);
    }
    const CentroidFrame &frame = measured.frame;
    auto *uv = arena.take<Point>(static_cast<size_t>(frame.count));
    const Vector3 acceleration = measured.rolling ? hypothesis.acceleration() : Vector3{};
    for (int m = 0; m < frame.count; ++m) {
        const st_centroid &one = frame.centroid[m];
        const Point seen{one.u_px, one.v_px};
        uv[m] = measured.rolling
                    ? at_frame_time(lens_, seen, one.delay_s, predicted.rate_rad_s, acceleration)
                    : seen;
    }
    const FollowedStars stars{measured.tracks, measured.icrf, measured.confirmed};
    return correct(lens(), stars, {options_.min_stars, sigmas(STAR_OUTLIER)}, predicted,
                   {frame.count, uv, measured.scaled}, measured.delay_s, detection_, arena,
                   *measured.work);
}

/// Whether the fit of the inliers is good and its innovation within the gate.
bool AttitudeModel::is_consistent(const Correction &correction, double gate) const {
    return correction.agreed && square(correction.innovation) <= gate &&
           is_good(correction.inliers, correction.stars, correction.residual_px,
                   options_.min_stars, options_.max_residual_px);
}

// --- update ---

/// Update state and tracks by the hypothesis that the stars confirm.
void AttitudeModel::use(const Explanation &confirmed, const Measured &measured, const Gyro &gyro,
                        TrackList &bank, FrameUpdate &update, Arena &arena) {
    const Hypothesis &hypothesis = confirmed.hypothesis;
    const Correction &correction = confirmed.correction;
    const AttitudeState before = state_;
    const bool was_used = uses_gyro_;
    correlated_ = measured.correlated;
    update_by(confirmed, measured);
    set_motion(hypothesis.uses_gyro);
    doubt_jump(before, hypothesis, measured.frame);
    doubt_shutter(correction);

    update.good = update.has_fit = true;
    update.quaternion = state_.quaternion;
    update.covariance = block(covariance_, 0, 0);
    update.inliers = correction.inliers;
    update.residual_px = correction.residual_px;
    update.chi2 = correction.chi2;
    update.scale = scale_.value;
    update.normalised = correction.normalised;

    add_frame(
        {before.stamp_ns, before.quaternion, before.rate_rad_s},
        {hypothesis.state.stamp_ns, hypothesis.state.quaternion, hypothesis.state.rate_rad_s},
        {state_.stamp_ns, state_.quaternion, state_.rate_rad_s}, correction.turn,
        correction.turn_covariance + measured.correlated, jitter_);
    follow_tracks(correction, measured, acceleration_of(motion_), true, bank, update, arena);

    double least_px = INFINITY;
    for (const st_centroid &one : measured.frame) {
        least_px = std::fmin(least_px, scale_.value * one.sigma_px);
    }
    add_frame(correction.typical, correction.precise, least_px <= options_.sigma_floor_px, scale_);
    auto *star = arena.take<int32_t>(static_cast<size_t>(update.detected.count));
    for (int k = 0; k < update.detected.count; ++k) {
        star[k] = bank[update.detected[k].track].star;
    }
    if (add_frame(lens_, star, update.detected.item, update.detected.count, lens_error_, arena)) {
        // A better lens is known from now on.
        scale_.frames = 0;
    }
    diverged_ = 0;
    check_covariance();
    compare_gyro(before.stamp_ns, was_used, bank, *measured.sky, gyro, arena);
}

/// Propagate without an update: every star counts as missed.
void AttitudeModel::go_without(const Explanation &nominal, const Measured &measured,
                               const Gyro &gyro, TrackList &bank, FrameUpdate &update,
                               Arena &arena) {
    const Hypothesis &hypothesis = nominal.hypothesis;
    const Vector3 acceleration = hypothesis.acceleration();
    interrupt_jitter(jitter_);
    if (hypothesis.motion != nullptr) {
        next_ = *hypothesis.motion;
    } else {
        next_ = motion_;
        restart_motion(hypothesis.state, next_);
    }
    interrupt_motion(next_);
    set_motion(hypothesis.uses_gyro);
    follow_tracks(nominal.correction, measured, acceleration, false, bank, update, arena);
    const double beyond = norm(nominal.correction.innovation);
    diverged_ = beyond > sigmas(DIVERGED) ? diverged_ + 1 : 0;
    if (diverged_ >= DIVERGED.frames) {
        failure_ = reason_of(DIVERGED, {static_cast<double>(diverged_), sigmas(DIVERGED), beyond});
    }
    if (measured.sparse && hypothesis.uses_gyro && is_saturated(measured.stamp_ns, gyro)) {
        failure_ = reason_of(GYRO_BLIND, {});
    }
    check_covariance();
}

/// Fill next_ with the motion after a frame, and set the attitude that its stars measure.
void AttitudeModel::update_by(const Explanation &confirmed, const Measured &measured) {
    const Hypothesis &hypothesis = confirmed.hypothesis;
    const Correction &correction = confirmed.correction;
    const AttitudeState &state = hypothesis.state;
    has_measured_ = true;
    measured_quaternion_ = turned(state.quaternion, correction.turn);
    measured_covariance_ = correction.turn_covariance + measured.correlated;
    if (hypothesis.motion == nullptr) {
        next_ = motion_;
        AttitudeState after = correction.state;
        add_block(measured.correlated, 0, after.covariance);
        restart_motion(after, next_);
    } else {
        // An acceleration shows in rows, less the one that was assumed, and in streaks.
        MotionMeasurement<0> seen{};
        seen.quaternion = state.quaternion;
        seen.rate_rad_s = state.rate_rad_s;
        seen.stars = correction.measured;
        seen.moved = correction.by_acceleration * hypothesis.acceleration();
        const Matrix3 by_streaks = this->by_streaks(measured.frame, state.rate_rad_s);
        for (int i = 0; i < 6; ++i) {
            for (int j = 0; j < 3; ++j) {
                seen.beside[i][j] =
                    correction.by_acceleration[i][j] + (i < 3 ? by_streaks[i][j] : 0.0);
            }
        }
        // The stars show the pointing up to the error that they share, however the body moved.
        next_ = *hypothesis.motion;
        add_turn_error(measured.correlated, next_);
        update_motion(seen, next_);
        add_turn_error(measured.correlated, next_);
    }
    measure_motion(motion_.stamp_ns, measured_quaternion_, correction.turn_covariance, next_);
}

/// Let next_ be the motion; where the use of the gyro ends its drift becomes unknown.
void AttitudeModel::set_motion(bool uses_gyro) {
    if (uses_gyro_ && !uses_gyro) {
        restart_motion(with_new_drift(state_of(next_), drift_sigma_rad_s_), motion_);
    } else {
        motion_ = next_;
    }
    uses_gyro_ = uses_gyro;
    state_ = state_of(motion_);
    const Matrix<6, 6> vibration = vibration_covariance(motion_);
    Matrix<6, 6> own;
    for (int i = 0; i < 6; ++i) {
        for (int j = 0; j < 6; ++j) {
            own[i][j] = state_.covariance[i][j] + vibration[i][j];
        }
    }
    covariance_ = with_tails(motion_, own);
}

/// Return by what an acceleration turns streaks from the mean pointing, in s^2.
///
/// The fit of a long streak sees its ends, whose middle is T^2 / 8 - T^2 / 24 of the acceleration
/// away, along the motion.
Matrix3 AttitudeModel::by_streaks(const CentroidFrame &frame, const Vector3 &rate_rad_s) const {
    const double speed2 = square(rate_rad_s);
    if (speed2 == 0 || !are_streaks(frame)) {
        return {};
    }
    const double exposure_s = std::fmin(frame.exposure_s[1], motion_.interval_s);
    const double length_px = lens_.fx * std::hypot(rate_rad_s[0], rate_rad_s[1]) * exposure_s;
    const double ratio = STREAK_PX / std::fmax(length_px, 1e-9);
    const double share = 1 / (1 + ratio * ratio);
    return outer(scaled(rate_rad_s, share * exposure_s * exposure_s / 12 / speed2), rate_rad_s);
}

/// Bring the tracks that are in the image to the state, with their centroids where the frame is
/// used; list the detected stars.
void AttitudeModel::follow_tracks(const Correction &correction, const Measured &measured,
                                  const Vector3 &acceleration_rad_s2, bool used, TrackList &bank,
                                  FrameUpdate &update, Arena &arena) {
    const CentroidFrame &frame = measured.frame;
    const auto centroids = static_cast<size_t>(frame.count);
    const auto count = static_cast<size_t>(correction.count);
    update.frame = frame;
    update.unassociated = correction.association.unassociated;
    auto *uv = arena.take<Point>(centroids);
    auto *moved = measured.rolling ? arena.take<st_centroid>(centroids) : nullptr;
    for (int m = 0; m < frame.count; ++m) {
        const st_centroid &one = frame.centroid[m];
        uv[m] = {one.u_px, one.v_px};
        if (measured.rolling) {
            uv[m] =
                at_frame_time(lens_, uv[m], one.delay_s, state_.rate_rad_s, acceleration_rad_s2);
            moved[m] = one;
            moved[m].u_px = uv[m].x;
            moved[m].v_px = uv[m].y;
            moved[m].delay_s = 0.0;
        }
    }
    if (measured.rolling) {
        update.frame.centroid = moved;
    }
    const Lens lens = this->lens();
    const Matrix3 R = matrix_from_quaternion(state_.quaternion);
    auto *icrf = arena.take<Vector3>(count);
    for (int k = 0; k < correction.count; ++k) {
        const int n = correction.star[k];
        bank[k] = bank[n];
        icrf[k] = measured.icrf[n];
        Track &track = bank[k];
        const ImageMotion image = on_image(lens, R, icrf[k], state_);
        track.state = image.state;
        track.covariance = image.covariance;
        if (used) {
            follow(track, correction.association, k, correction.predicted[k], uv,
                   update.frame.centroid, measured.variance);
        } else {
            miss(track);
        }
    }
    bank.count = correction.count;
    if (used) {
        update.has_residuals = true;
        update.detected = arena.list<DetectedStar>(count);
        detected_stars(lens, state_.quaternion, state_.rate_rad_s, bank, icrf,
                       correction.distance_px, correction.best, {frame.count, uv, measured.error},
                       update.detected);
    }
}

// --- check ---

/// Add what a motion that begins within the frame may have done, or what else it may be.
///
/// Stars whose flux jumps within the exposure are not seen at its mean, and rows of a rolling shutter
/// are exposed before and after. A timestamp error looks like a jump as well.
void AttitudeModel::doubt_jump(const AttitudeState &before, const Hypothesis &hypothesis,
                               const CentroidFrame &frame) {
    if (hypothesis.motion == nullptr) {
        return;
    }
    const double sudden = total_weight(motion_.weight, SUDDEN);
    const double interval_s = static_cast<double>(state_.stamp_ns - before.stamp_ns) * 1e-9;
    const double doubt = sudden * std::fmax(std::fmin(frame.exposure_s[1] / interval_s, 1.0),
                                            JUMP_IN_FRAME.probability);
    const Matrix3 own = block(covariance_, 0, 0);
    const bool is_displaced = st::is_displaced(jump_, state_.rate_rad_s, block(covariance_, 3, 3));
    const bool jumps = total_weight(motion_.weight, SMOOTH) < 0.5;
    jump_.left = std::max(jump_.left - 1, 0);
    if (jumps || doubt > 2 * MISSED_LIGHT) {
        const Vector3 moved =
            rotation_between(state_of(*hypothesis.motion).quaternion, state_.quaternion);
        const double off = ACROSS * across(moved, before.rate_rad_s);
        add_block(covariance_deficit(own, moved, off, doubt), 0, covariance_);
        if (jumps && !is_displaced) {
            jump_ = {true, before.rate_rad_s, moved, DISPLACED.frames};
        } else if (jumps && norm(moved) > norm(jump_.moved_rad)) {
            jump_.moved_rad = moved;
        }
    }
    if (is_displaced) {
        add_block(covariance_deficit(own, jump_.moved_rad, 0.0, 1.0), 0, covariance_);
    }
    if (jump_.any) {
        const double variance = unseen_variance(jump_, total_weight(motion_.share, SUDDEN));
        for (int axis = 0; axis < 3; ++axis) {
            covariance_[axis][axis] += variance;
        }
    }
    if (is_rolling(frame)) {
        double square_s2 = 0.0;
        for (const st_centroid &one : frame) {
            square_s2 += one.delay_s * one.delay_s;
        }
        const double spread_s = std::sqrt(square_s2 / frame.count);
        Vector<6> error;
        for (int axis = 0; axis < 3; ++axis) {
            const double change = state_.rate_rad_s[axis] - before.rate_rad_s[axis];
            error[axis] = spread_s * change;
            error[3 + axis] = change / 2;
        }
        for (int i = 0; i < 6; ++i) {
            for (int j = 0; j < 6; ++j) {
                covariance_[i][j] += sudden * error[i] * error[j];
            }
        }
    }
}

/// Set the turn by 1 sigma of an error of line_time_us, and add its error of the rate.
///
/// Such an error is one of the rate that brings the rows to one time, by the same share. The more
/// frames there are, the smaller is one that their rows do not show.
void AttitudeModel::doubt_shutter(const Correction &correction) {
    if (correction.measured.size > 3) {
        const double frames = frames_ + 1;
        const Vector3 error =
            scaled(state_.rate_rad_s,
                   std::fmax(LINE_TIME_SIGMA / (frames * frames), LEAST_LINE_TIME_SIGMA));
        const Matrix<6, 6> &information = correction.measured.information;
        shutter_rad_ = divided(block(information, 0, 3) * error, block(information, 0, 0));
        add_block(outer(error, error), 3, covariance_);
    }
    ++frames_;
}

/// Set the failure of a state whose covariance is not finite or not positive definite.
void AttitudeModel::check_covariance() {
    double sum = 0.0;
    st_reason reason = reason_of(FILTER_COVARIANCE, {});
    for (int i = 0; i < STATE_SIZE; ++i) {
        reason.figure[i] = state_.covariance[i][i];
        for (int j = 0; j < STATE_SIZE; ++j) {
            sum += state_.covariance[i][j];
        }
    }
    Matrix<STATE_SIZE, STATE_SIZE> L;
    if (!std::isfinite(sum) || !cholesky(state_.covariance, L)) {
        failure_ = reason;
    }
}

/// Use the gyro once it has agreed with the stars for confirm_frames; report if it does not.
///
/// A wrong unit, axis or sign gives rates that would lose the stars.
void AttitudeModel::compare_gyro(int64_t before_ns, bool was_used, const TrackList &bank,
                                 const SkyFile &sky, const Gyro &gyro, Arena &arena) {
    const int64_t stamp_ns = state_.stamp_ns;
    if (is_saturated(stamp_ns, gyro)) {
        interrupt_agreement(agreement_);
        gyro_trouble_ = reason_of(GYRO_AT_RANGE, {});
        return;
    }
    if (gyro.silent_s(stamp_ns) > SILENCE_S) {
        interrupt_agreement(agreement_);
        gyro_trouble_ = {};
        return;
    }
    bool contradicts = was_used && !uses_gyro_;
    if (contradicts) {
        contradict_agreement(agreement_);
    } else {
        st_budget budget{};
        set(measured_covariance_, budget.stars);
        add_lasting_errors(lens_, bank, sky, lasting_errors(), nullptr, measured_quaternion_,
                           budget, arena);
        contradicts = add_frame(gyro,
                                {stamp_ns, measured_quaternion_, covariance_of(budget),
                                 state_.drift_rad_s, block(state_.covariance, 6, 6)},
                                agreement_);
        if (contradicts) {
            next_ = motion_;
            set_motion(false);
        }
    }
    if (contradicts) {
        const Vector3 reported = gyro.mean_rate(before_ns, stamp_ns).rate_rad_s;
        const Vector3 &stars = state_.rate_rad_s;
        gyro_trouble_ = reason_of(
            GYRO_DIFFERS, {reported[0], reported[1], reported[2], stars[0], stars[1], stars[2]});
    } else if (!uses_gyro_ && is_enough(agreement_, options_.confirm_frames)) {
        uses_gyro_ = true;
        gyro_trouble_ = {};
    }
}

// --- results ---

LastingErrors AttitudeModel::lasting_errors() const {
    return {lens_error_.value_px, lens_error_.scale_sigma, jitter_.turn_rad};
}

st_budget AttitudeModel::budget(const Matrix3 &own, bool of_frame) const {
    st_budget budget{};
    if (!has_measured_) {
        set(own, budget.stars);
        return budget;
    }
    set(outer(shutter_rad_, shutter_rad_), budget.shutter);
    set(correlated_, budget.exposure);
    if (of_frame) {
        set(own - correlated_, budget.stars);
        return budget;
    }
    const Matrix3 motion = own - block(state_.covariance, 0, 0);
    set(own - motion - correlated_, budget.stars);
    set(motion, budget.motion);
    return budget;
}

bool AttitudeModel::predicted(st_hint &hint) const {
    if (total_weight(motion_.weight, SMOOTH) < MOTION_ENDS.probability) {
        return false;
    }
    const AttitudeState state = state_of(motion_, weights_of(motion_.weight, SMOOTH));
    hint.stamp_ns = state.stamp_ns;
    set(state.quaternion, hint.quaternion);
    set(state.rate_rad_s, hint.rate_rad_s);
    set(block(state.covariance, 0, 0), hint.covariance_rad2);
    set(block(state.covariance, 3, 3), hint.rate_covariance);
    return true;
}

Matrix3 AttitudeModel::rate_covariance() const {
    return block(covariance_, 3, 3);
}

Matrix3 AttitudeModel::cross_covariance() const {
    return block(covariance_, 0, 3);
}

Course AttitudeModel::course() const {
    return motion_.interval_s == 0 ? Course{} : course_of(motion_, noise_.acceleration_rad_s2);
}

size_t AttitudeModel::work_bytes(int tracks, int centroids) {
    const auto n = static_cast<size_t>(tracks), m = static_cast<size_t>(centroids);
    return Arena::padded<std::byte>(correction_work_bytes(tracks, centroids)) +
           MOST_CORRECTIONS * (correction_bytes(tracks, centroids) + Arena::padded<Point>(m)) +
           2 * Arena::padded<Vector3>(n) + Arena::padded<bool>(n) + Arena::padded<int32_t>(n) +
           Arena::padded<DetectedStar>(n) + 2 * Arena::padded<double>(m) +
           2 * Arena::padded<Covariance2>(m) + Arena::padded<Point>(m) +
           Arena::padded<st_centroid>(m) + lens_error_bytes(tracks) + lasting_errors_bytes(tracks);
}

}  // namespace st
