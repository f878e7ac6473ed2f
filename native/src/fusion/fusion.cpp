// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "fusion/fusion.h"

#include <cmath>
#include <cstring>

#include "integrity/checks.h"
#include "maths/jacobi.h"
#include "maths/symmetric.h"

namespace st {

namespace {

/// Accelerations before a start, in units of acceleration_deg_s2, and before one that follows.
constexpr double START_FACTOR = 10.0, RESTART_FACTOR = 100.0;
constexpr int PLAUSIBLE_FRAMES = 4;  // of a head from one check of its mount to the next
constexpr int RESTART_FRAMES = 3;    // in a row that no state can be compared with
constexpr double SHARP_RAD =
    10 * ARCSEC;  // a prediction that decides alone whether a head is right
constexpr double START_RAD = 0.1, START_RAD_S = 0.1;
constexpr int START_FRAMES = 3;   // of a start, at most
constexpr double FRAME_S = 0.05;  // of a head, at least, for what is derived
constexpr int SPARE_FRAMES = 16, DERIVED_RATES = 1 << 16;

// Velocity of the Earth about the Sun, and of a low orbit, per axis.
constexpr double EARTH_M_S = 29.8e3, ORBIT_M_S = 7.9e3, LIGHT_M_S = 299'792'458.0;
constexpr int64_t FIRST_DATE_NS = 946'728'000'000'000'000;  // J2000, as UTC
constexpr double LAST_DATE_YEARS = 100.0, YEAR_S = 365.25 * 86400;

const double GATE = checks::HEAD_DIFFERS.threshold;
const double RETURN_GATE = checks::HEAD_RETURNS.threshold;

double seconds(int64_t ns) {
    return static_cast<double>(ns) * 1e-9;
}

double square(double x) {
    return x * x;
}

st_reason difference(const HeadInnovation &innovation) {
    return reason_of(ST_HEAD_DIFFERS, {norm(innovation.z) * 180 / M_PI});
}

/// Whether a stamp is UTC of a date from 2000 to 2100.
bool is_date(int64_t stamp_ns) {
    const double years = seconds(stamp_ns - FIRST_DATE_NS) / YEAR_S;
    return 0 <= years && years <= LAST_DATE_YEARS;
}

}  // namespace

// --- memory ---

int Fusion::coefficients_of(const st_fusion_config &config, const st_mount *mounts) {
    int total = 0;
    for (int k = 0; k < config.heads; ++k) {
        total += Head::coefficients_of(k, mounts[k], config.mount);
    }
    return total;
}

/// Return how many frames are stored, at least those of a start.
static int frames_of(const st_fusion_config &config) {
    if (config.frames > 0) {
        return config.frames > START_FRAMES ? config.frames : START_FRAMES;
    }
    return SPARE_FRAMES + config.heads * static_cast<int>(config.fusion.horizon_s / FRAME_S);
}

static int rates_of(const st_fusion_config &config) {
    return config.rates > 0 ? config.rates : DERIVED_RATES;
}

size_t Fusion::bytes(const st_fusion_config &config, const st_mount *mounts) {
    const int m = coefficients_of(config, mounts);
    const auto heads = static_cast<size_t>(config.heads);
    return heads * Arena::padded<double>(static_cast<size_t>(config.fusion.agree_frames)) +
           Arena::padded<st_mount_step>(heads) + Arena::padded<Series>(heads) +
           Arena::padded<MeasuredRate>(static_cast<size_t>(rates_of(config))) +
           Arena::padded<double>(static_cast<size_t>(m * m)) +
           History::bytes(frames_of(config), m) + History::bytes(START_FRAMES, m) +
           2 * Arena::padded<BodyMotionState>(1);
}

void Fusion::start(const st_fusion_config &config, const st_mount *mounts, Arena &arena) {
    config_ = config;
    count_ = config.heads;
    coefficient_count_ = coefficients_of(config, mounts);
    needed_ = config.fusion.start_heads < count_ ? config.fusion.start_heads : count_;
    double walk[MOST_CONSTANTS];
    int first = 0;
    for (int k = 0; k < count_; ++k) {
        heads_[k].start(k, mounts[k], config, first,
                        arena.take<double>(static_cast<size_t>(config.fusion.agree_frames)));
        for (int c = 0; c < heads_[k].columns.count; ++c) {
            walk[first + c] = heads_[k].walk(c);
        }
        first += heads_[k].columns.count;
    }
    steps_ = arena.list<st_mount_step>(static_cast<size_t>(count_));
    auto *series = arena.take<Series>(static_cast<size_t>(count_));
    const int rates = rates_of(config);
    motion_.start(config, walk, coefficient_count_,
                  arena.take<MeasuredRate>(static_cast<size_t>(rates)), rates);
    mount_covariance_ =
        arena.take<double>(static_cast<size_t>(coefficient_count_ * coefficient_count_));
    history_.start(frames_of(config), coefficient_count_, arena);
    begun_.start(START_FRAMES, coefficient_count_, arena);
    before_ = arena.take<BodyMotionState>(1);
    after_ = arena.take<BodyMotionState>(1);
    detector_.start(count_, series);
    reset();
}

void Fusion::reset() {
    for (int k = 0; k < count_; ++k) {
        heads_[k].reset();
    }
    reset_mounts();
    motion_.reset();
    detector_.restart();
    steps_.clear();
    drop(reason_of(ST_FUSION_WAITING, {}));
    has_previous_ = false;
}

/// Drop the attitude, not the mounts.
void Fusion::drop(const st_reason &trouble) {
    history_.clear();
    trouble_ = trouble;
    untested_ = 0;
    motion_.forget_gyro();
}

// --- input ---

void Fusion::add_frame(int number, const HeadFrame &given, st_fused &fused) {
    steps_.clear();
    Head &head = heads_[number];
    HeadFrame frame = given;
    if (!head.accept(frame)) {
        ++head.counts.repeated;
        head.reason = reason_of(ST_HEAD_REPEATS, {});
        return;
    }
    if (history_.count() == 0) {
        start_with(head, frame, fused);
        return;
    }
    const int64_t newest_ns = history_.newest().stamp_ns();
    const double late_s = seconds(newest_ns - frame.stamp_ns);
    if (late_s > config_.fusion.horizon_s || frame.stamp_ns < history_[0].stamp_ns()) {
        ++head.counts.late;
        head.reason = reason_of(ST_HEAD_LATE, {late_s});
    } else if (-late_s > motion_.bridged_s(frame.stamp_ns)) {
        ++head.counts.ahead;
        head.reason = reason_of(ST_HEAD_AHEAD, {-late_s});
    } else if (motion_.extrapolates(frame.stamp_ns) && live(newest_ns, &head) > 0) {
        ++head.counts.ahead;
        head.reason = reason_of(ST_HEAD_AHEAD_OF_GYRO, {-late_s});
    } else {
        test(head, frame, fused);
        return;
    }
    if (head.state == ST_HEAD_USED && head.is_silent(newest_ns, config_.fusion.max_gap_s)) {
        head.enter(ST_HEAD_CHECKED, st_reason{head.reason});
    }
    if (++untested_ >= RESTART_FRAMES) {
        start_with(head, frame, fused);
    }
}

// --- from frame to frame ---

HeadMeasurement Fusion::measurement(const FusedState &state, const Head &head,
                                    const HeadFrame &frame) const {
    return head.measurement(frame, state.coefficients + head.columns.first);
}

HeadInnovation Fusion::innovation(const FusedState &state, const Head &head,
                                  const HeadFrame &frame) const {
    return innovation_of(state.body, measurement(state, head, frame));
}

/// Update a motion by a frame, of which state_ is the prediction.
void Fusion::use(const Head &head, const HeadFrame &frame, int64_t before_ns,
                 BodyMotionState &motion) const {
    update_by_head(measurement(state_, head, frame), before_ns,
                   state_.coefficients + head.columns.first, motion);
}

/// Compare a frame with the state of its time and use it if the head counts.
void Fusion::test(Head &head, const HeadFrame &frame, st_fused &fused) {
    const int index = history_.place_of(frame.stamp_ns);
    const bool is_newest = index == history_.count();
    history_[index - 1].load(*before_);
    const int64_t before_ns = before_->stamp_ns;
    motion_.propagate(*before_, frame.stamp_ns, *after_, state_);
    if (gave_up(state_)) {
        return;
    }
    HeadInnovation found = innovation(state_, head, frame);
    // Written so that NaN is rejected.
    if (!(found.nis <= GATE) && is_newest && is_alone(head, frame.stamp_ns)) {
        for (const ModeSet mode : WIDE) {
            fuse(*after_, weights_of(after_->weight, mode), state_);
            found = innovation(state_, head, frame);
            if (found.nis <= GATE) {
                break;
            }
        }
    }
    if (head.state == ST_HEAD_USED) {
        head.noise.add(found.nis, least_noise(frame.stamp_ns, head));
    }
    if (!(found.nis <= GATE)) {
        ++head.counts.disagreeing;
        dispute(head, frame, found, fused);
        return;
    }
    if (!counts(head, frame, found)) {
        ++head.counts.not_counted_yet;
        return;
    }
    update_by_head(found.measured, before_ns, state_.coefficients + head.columns.first, *after_);
    fuse(*after_, after_->weight, updated_);
    if (gave_up(updated_)) {
        return;
    }
    ++head.counts.used;
    const Offset offset = offset_of(head, found);
    insert(index, head, frame);
    observe(head, frame.stamp_ns, offset);
    head.used_ns = head.has_used && head.used_ns > frame.stamp_ns ? head.used_ns : frame.stamp_ns;
    head.has_used = true;
    if (!is_newest ||
        (head.counts.used % PLAUSIBLE_FRAMES == 0 && has_implausible_mounts(frame.stamp_ns))) {
        return;
    }
    if (motion_.compare_gyro(head.number, before_ns, updated_.body, found.measured)) {
        forget_motion();
    }
    fill(fused);
}

/// Drop a state without a valid covariance, with the mounts estimated; return whether it is.
bool Fusion::gave_up(const FusedState &state) {
    if (has_covariance(state.body)) {
        return false;
    }
    st_reason reason = reason_of(ST_FUSION_NOT_POSITIVE, {});
    for (int k = 0; k < STATE_SIZE; ++k) {
        reason.figure[k] = state.body.covariance[k][k];
    }
    drop(reason);
    reset_mounts();
    return true;
}

/// Whether a frame that agrees counts; counts how long its head has agreed.
bool Fusion::counts(Head &head, const HeadFrame &frame, const HeadInnovation &found) {
    const st_fusion_options &options = config_.fusion;
    if (head.state == ST_HEAD_USED && !head.is_silent(frame.stamp_ns, options.max_gap_s)) {
        head.disagreed = 0;
        head.reason = {};
        return true;
    }
    double variance = 0.0;
    for (int axis = 0; axis < 3; ++axis) {
        variance = std::fmax(variance, state_.body.covariance[axis][axis]);
    }
    if (live(frame.stamp_ns, &head) == 0 && std::sqrt(variance) > SHARP_RAD && needed_ > 1) {
        head.enter(ST_HEAD_CHECKED, reason_of(ST_HEAD_UNCHECKED, {}));
        if (++untested_ >= RESTART_FRAMES) {
            drop(reason_of(ST_FUSION_UNCONFIRMED, {}));
        }
        return false;
    }
    if (head.state == ST_HEAD_USED || head.state == ST_HEAD_WAITING) {
        head.enter(ST_HEAD_CHECKED, reason_of(ST_HEAD_RETURNS, {}));
    }
    head.add_agreed(found.nis);
    if (head.agreed_count() < options.agree_frames) {
        return false;
    }
    if (!(head.agreed_sum() <= options.agree_frames * RETURN_GATE)) {
        // An error that lasts shows in the mean, though each frame is within the gate.
        head.enter(ST_HEAD_EXCLUDED, difference(found));
        return false;
    }
    if (!(found.nis <= RETURN_GATE)) {
        return false;
    }
    head.enter(ST_HEAD_USED, {});
    return true;
}

/// Use no frame that disagrees, unless two heads are more than those that agree.
void Fusion::dispute(Head &head, const HeadFrame &frame, const HeadInnovation &found,
                     st_fused &fused) {
    const st_reason differs = difference(found);
    head.clear_agreed();
    head.reason = differs;
    const int disagreed = ++head.disagreed;
    if (head.state != ST_HEAD_USED || disagreed >= config_.fusion.exclude_frames) {
        head.enter(ST_HEAD_EXCLUDED, differs);
        head.disagreed = disagreed;
    }
    const int agreeing = live(frame.stamp_ns);
    const int64_t newest_ns = history_.newest().stamp_ns();
    const bool restarted = agreeing < 2 && start_with(head, frame, fused);
    if (!restarted && agreeing == 0 && live(newest_ns) == 0) {
        trouble_ =
            reason_of(ST_FUSION_NONE_LEFT, {static_cast<double>(head.number), differs.figure[0]});
    }
}

/// Insert a frame with the motion after it, use those after it again, and forget those beyond the
/// horizon.
void Fusion::insert(int index, const Head &head, const HeadFrame &frame) {
    history_.insert(index).store(frame, head.number, *after_);
    for (int k = index + 1; k < history_.count(); ++k) {
        FusionEntry &later = history_[k];
        history_[k - 1].load(*before_);
        motion_.propagate(*before_, later.frame.stamp_ns, *after_, state_);
        use(heads_[later.head], later.frame, before_->stamp_ns, *after_);
        later.store(*after_);
    }
    if (index + 1 < history_.count()) {
        fuse(*after_, after_->weight, updated_);
    }
    history_.forget_until(history_.newest().stamp_ns() -
                          std::llrint(config_.fusion.horizon_s * 1e9));
    follow_mounts(updated_);
    untested_ = 0;
    trouble_ = {};
}

/// The attitude goes on with a rate and a drift of which nothing is known.
void Fusion::forget_motion() {
    BodyState &body = updated_.body;
    const double variance[2] = {square(START_RAD_S), square(motion_.drift_sigma_rad_s())};
    for (int i = 3; i < STATE_SIZE; ++i) {
        for (int k = 0; k < body.size(); ++k) {
            body.covariance[i][k] = body.covariance[k][i] = 0.0;
        }
        body.covariance[i][i] = variance[i / 3 - 1];
    }
    body.drift_rad_s = {};
    const Vector3 noise = after_->noise_rad2;
    const double interval_s = after_->interval_s;
    start_motion(body, updated_.coefficients, noise, interval_s, *after_);
    fuse(*after_, after_->weight, updated_);
    history_.newest().store(*after_);
}

/// Fill the attitude of the newest state.
void Fusion::fill(st_fused &fused) {
    const BodyState &state = updated_.body;
    const Matrix<6, 6> P = with_tails(*after_, block<6, 6>(state.covariance, 0, 0));
    // The first has w >= 0.
    previous_ = sign_continuous(state.quaternion,
                                has_previous_ ? previous_ : Quaternion{0.0, 0.0, 0.0, 1.0});
    has_previous_ = true;
    const double lasting = lasting_rad2();
    const double q[4] = {previous_.x, previous_.y, previous_.z, previous_.w};
    std::memcpy(fused.quaternion, q, sizeof(q));
    for (int i = 0; i < 3; ++i) {
        fused.rate_rad_s[i] = state.rate_rad_s[i];
        fused.drift_rad_s[i] = state.drift_rad_s[i];
        for (int k = 0; k < 3; ++k) {
            fused.covariance_rad2[i][k] = P[i][k] + (i == k ? lasting : 0.0);
            fused.rate_covariance[i][k] = P[3 + i][3 + k];
            fused.drift_covariance[i][k] = state.covariance[6 + i][6 + k];
        }
    }
    fused.stamp_ns = state.stamp_ns;
    fused.valid = 1;
}

/// Return the variance per axis of an error that is in all frames: of an unknown date.
double Fusion::lasting_rad2() const {
    if (is_date(history_.newest().stamp_ns())) {
        return 0.0;
    }
    // Across the boresight, which two axes are. Heads of a sky without aberration have less.
    const double across = symmetric_eigen(history_.newest().frame.covariance).value[1];
    const double aberration2 = (square(EARTH_M_S) + square(ORBIT_M_S)) / 3 / square(LIGHT_M_S);
    return std::fmin(across, aberration2);
}

// --- heads that count ---

bool Fusion::is_missing(int number, int64_t stamp_ns) const {
    return heads_[number].is_silent(stamp_ns, config_.fusion.max_gap_s);
}

/// Whether a head counts and its last frames did.
bool Fusion::is_live(const Head &head, int64_t stamp_ns) const {
    return head.state == ST_HEAD_USED && head.disagreed == 0 &&
           !head.is_silent(stamp_ns, config_.fusion.max_gap_s);
}

/// Return how many heads count, but for one.
int Fusion::live(int64_t stamp_ns, const Head *but) const {
    int count = 0;
    for (int k = 0; k < count_; ++k) {
        count += &heads_[k] != but && is_live(heads_[k], stamp_ns) ? 1 : 0;
    }
    return count;
}

/// Whether a head without gyro is the only one that counts: it may manoeuvre.
bool Fusion::is_alone(const Head &head, int64_t stamp_ns) const {
    return is_live(head, stamp_ns) && !motion_.gyro_runs(stamp_ns) && live(stamp_ns, &head) == 0;
}

/// Return the smallest mean NIS of the other heads that count, NaN without any.
double Fusion::least_noise(int64_t stamp_ns, const Head &but) const {
    double least = NAN;
    for (int k = 0; k < count_; ++k) {
        if (&heads_[k] != &but && is_live(heads_[k], stamp_ns)) {
            least = std::fmin(least, heads_[k].noise.nis);
        }
    }
    return least;
}

// --- start ---

/// Start with two frames of a head and one of another that agrees, or with one head; return
/// whether it did. A state before is replaced: its mounts are used again, not its gyro.
bool Fusion::start_with(Head &head, const HeadFrame &frame, st_fused &fused) {
    st_reason trouble{};
    int found[ST_MOST_HEADS];
    const int candidate_count = candidates(head, frame, found);
    for (int c = 0; c < candidate_count; ++c) {
        const Head &other = heads_[found[c]];
        // Heads that have agreed before see a manoeuvre, others may be wrong by its size.
        const bool known =
            history_.count() > 0 && head.state == ST_HEAD_USED && other.state == ST_HEAD_USED;
        begin(other);
        if (&other == &head) {
            started(fused);
            return true;
        }
        motion_.propagate_at_constant_rate(*before_, frame.stamp_ns,
                                           known ? RESTART_FACTOR : START_FACTOR, *after_, state_);
        const HeadInnovation innovation_found = innovation(state_, head, frame);
        if (!(innovation_found.nis <= RETURN_GATE)) {
            const bool first = head.number < other.number;
            trouble = reason_of(ST_FUSION_DISAGREE,
                                {static_cast<double>(first ? head.number : other.number),
                                 static_cast<double>(first ? other.number : head.number),
                                 norm(innovation_found.z) * 180 / M_PI});
            continue;
        }
        add_begun(head, frame);
        started(fused);
        return true;
    }
    if (history_.count() == 0) {
        trouble_ = trouble.code != 0
                       ? trouble
                       : reason_of(needed_ > 1 ? ST_FUSION_NO_PAIR : ST_FUSION_WAITING, {});
    }
    return false;
}

/// List the heads that may confirm a frame, excluded ones only if there are no others.
int Fusion::candidates(const Head &head, const HeadFrame &frame, int *found) const {
    int count = 0;
    if (needed_ == 1) {
        if (is_candidate(head, frame)) {
            found[count++] = head.number;
        }
        return count;
    }
    const auto is_good = [&](const Head &one) {
        return one.state != ST_HEAD_EXCLUDED &&
               one.has_frames(frame.stamp_ns, config_.fusion.max_gap_s);
    };
    int good = 0;
    for (int k = 0; k < count_; ++k) {
        good += is_good(heads_[k]) ? 1 : 0;
    }
    if (good > 1 && !is_good(head)) {
        return 0;
    }
    for (int k = 0; k < count_; ++k) {
        const Head &one = heads_[k];
        if (&one != &head && (good < 2 || is_good(one)) && is_candidate(one, frame)) {
            found[count++] = k;
        }
    }
    return count;
}

/// Whether another head has new frames of its own that are in use nowhere.
bool Fusion::is_candidate(const Head &other, const HeadFrame &frame) const {
    if (other.recent_count < 2 ||
        (history_.count() > 0 && other.has_used && other.used_ns == other.recent[1].stamp_ns)) {
        return false;
    }
    const double age_s = seconds(frame.stamp_ns - other.recent[1].stamp_ns);
    const double step_s = seconds(other.recent[1].stamp_ns - other.recent[0].stamp_ns);
    const double most_s = config_.fusion.max_gap_s;
    return 0 <= age_s && age_s <= most_s && 0 < step_s && step_s <= most_s;
}

/// Fill the motions after two frames of a head, by a prior that knows nothing; the second is in
/// before_.
void Fusion::begin(const Head &head) {
    const auto &[first, second] = head.recent;
    const double *own = coefficients_ + head.columns.first;
    const HeadMeasurement seen = head.measurement(first, own);
    const double dt_s = seconds(second.stamp_ns - first.stamp_ns);
    BodyState &body = state_.body;
    body = {};
    body.stamp_ns = first.stamp_ns;
    body.quaternion = seen.quaternion;
    body.rate_rad_s = scaled(
        rotation_between(seen.quaternion, head.measurement(second, own).quaternion), 1 / dt_s);
    body.constants.count = coefficient_count_;
    const double sigma[3] = {START_RAD, START_RAD_S, motion_.drift_sigma_rad_s()};
    for (int i = 0; i < STATE_SIZE; ++i) {
        body.covariance[i][i] = square(sigma[i / 3]);
    }
    for (int i = 0; i < coefficient_count_; ++i) {
        for (int k = 0; k < coefficient_count_; ++k) {
            body.covariance[STATE_SIZE + i][STATE_SIZE + k] =
                mount_covariance_[i * coefficient_count_ + k];
        }
    }
    const Matrix3 &R = seen.covariance;
    start_motion(body, coefficients_, {{R[0][0], R[1][1], R[2][2]}}, dt_s, *before_);
    if (history_.count() > 0) {
        history_.newest().load(*after_);
        resume_motion(*after_, *before_);
    }
    begun_.clear();
    add_begun(head, first);
    add_begun(head, second);
}

/// Go on from the motion in before_ by a frame of a start, and leave what comes after there.
void Fusion::add_begun(const Head &head, const HeadFrame &frame) {
    motion_.propagate_without_gyro(*before_, frame.stamp_ns, *after_, state_);
    use(head, frame, before_->stamp_ns, *after_);
    begun_.insert(begun_.count()).store(frame, head.number, *after_);
    BodyMotionState *const exchanged = before_;
    before_ = after_;
    after_ = exchanged;
}

/// Use the motions of a start.
void Fusion::started(st_fused &fused) {
    const int64_t stamp_ns = begun_.newest().stamp_ns();
    if (history_.count() > 0 && motion_.gyro_runs(stamp_ns) &&
        seconds(stamp_ns - history_.newest().stamp_ns()) <= config_.fusion.max_gyro_gap_s) {
        motion_.contradict_gyro(reason_of(ST_FUSION_GYRO_HEADS, {}));
    }
    drop({});
    for (int k = 0; k < begun_.count(); ++k) {
        const FusionEntry &one = begun_[k];
        one.load(*after_);
        history_.insert(k).store(one.frame, one.head, *after_);
        Head &head = heads_[one.head];
        if (head.state != ST_HEAD_USED) {
            head.enter(ST_HEAD_USED, {});
        }
        head.disagreed = 0;
        head.reason = {};
        head.has_used = true;
        head.used_ns = one.frame.stamp_ns;
        ++head.counts.used;
    }
    fuse(*after_, after_->weight, updated_);
    follow_mounts(updated_);
    fill(fused);
}

// --- mounts ---

/// Return to what files and options have.
void Fusion::reset_mounts() {
    const int m = coefficient_count_;
    for (int k = 0; k < m * m; ++k) {
        mount_covariance_[k] = 0.0;
    }
    for (int h = 0; h < count_; ++h) {
        const Head &head = heads_[h];
        const int first = head.columns.first;
        for (int i = 0; i < head.columns.count; ++i) {
            coefficients_[first + i] = head.prior_mean()[i];
            for (int k = 0; k < head.columns.count; ++k) {
                mount_covariance_[(first + i) * m + first + k] = head.prior_covariance()[i][k];
            }
        }
    }
}

/// Use the mounts of a state.
void Fusion::follow_mounts(const FusedState &state) {
    const int m = coefficient_count_;
    for (int i = 0; i < m; ++i) {
        coefficients_[i] = state.coefficients[i];
        for (int k = 0; k < m; ++k) {
            mount_covariance_[i * m + k] = state.body.covariance[STATE_SIZE + i][STATE_SIZE + k];
        }
    }
}

void Fusion::misalignment(int number, int64_t stamp_ns, Vector3 &offset,
                          Matrix3 &covariance) const {
    const Head &head = heads_[number];
    const Sensitivity B = head.sensitivity(stamp_ns);
    const int m = coefficient_count_, first = head.columns.first;
    offset = {};
    covariance = {};
    for (int i = 0; i < 3; ++i) {
        for (int k = 0; k < head.columns.count; ++k) {
            offset[i] += B[i][k] * coefficients_[first + k];
            for (int n = 0; n < head.columns.count; ++n) {
                const double half = B[i][k] * mount_covariance_[(first + k) * m + first + n];
                for (int j = 0; j < 3; ++j) {
                    covariance[i][j] += half * B[j][n];
                }
            }
        }
    }
}

st_mount Fusion::estimated(int number) const {
    const Head &head = heads_[number];
    const int first = head.columns.first, m = coefficient_count_;
    return head.estimated(coefficients_ + first, mount_covariance_ + first * m + first, m);
}

/// Drop the attitude where a mount has left what its file allows, and exclude the head. The
/// reference, where two others have left theirs: all mounts are against it.
bool Fusion::has_implausible_mounts(int64_t stamp_ns) {
    bool is_wrong[ST_MOST_HEADS] = {};
    int wrong = 0;
    double names = 0.0;
    for (int k = 0; k < count_; ++k) {
        is_wrong[k] = !heads_[k].is_plausible(coefficients_ + heads_[k].columns.first, stamp_ns);
        wrong += is_wrong[k] ? 1 : 0;
        names += is_wrong[k] ? std::ldexp(1.0, k) : 0.0;
    }
    if (wrong == 0) {
        return false;
    }
    const st_reason reason = reason_of(ST_FUSION_MOUNTS_WRONG, {names});
    drop(reason);
    reset_mounts();
    // The mounts of those in use are against each other: any may be wrong.
    const bool any = heads_[0].state != ST_HEAD_USED || count_ == 2;
    for (int k = 0; k < count_; ++k) {
        if (any || (wrong > 1 ? k == 0 : is_wrong[k])) {
            heads_[k].enter(ST_HEAD_EXCLUDED, reason);
        }
    }
    return true;
}

/// Return the attitude of a head minus that of the predicted state, by the mount of its file.
Fusion::Offset Fusion::offset_of(const Head &head, const HeadInnovation &found) const {
    const HeadMeasurement &measured = found.measured;
    Offset offset{found.z, {}, {0, {}}};
    for (int i = 0; i < 3; ++i) {
        for (int k = 0; k < head.columns.count; ++k) {
            offset.rad[i] += measured.B[i][k] * state_.coefficients[head.columns.first + k];
        }
        offset.variance[i] = state_.body.covariance[i][i] + measured.covariance[i][i];
    }
    for (int k = 3; k < head.columns.count; k += 3) {
        offset.law.phi[offset.law.count++] = measured.B[0][k];
    }
    return offset;
}

/// Look for steps of the mounts in the differences of the heads. A mount that has made one is not
/// known.
void Fusion::observe(const Head &head, int64_t stamp_ns, const Offset &offset) {
    detector_.add(head.number, stamp_ns, offset.rad, offset.variance, offset.law, steps_);
    for (const st_mount_step &step : steps_) {
        Head &moved = heads_[step.head];
        const double square_rad =
            square(step.size_rad[0]) + square(step.size_rad[1]) + square(step.size_rad[2]);
        moved.stepped_rad2 += square_rad;
        for (int k = 0; k < history_.count(); ++k) {
            history_[k].widen(moved.columns, square_rad);
        }
    }
}

}  // namespace st
