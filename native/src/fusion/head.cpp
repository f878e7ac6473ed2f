// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "fusion/head.h"

#include <cmath>

#include "integrity/checks.h"
#include "maths/symmetric.h"

namespace st {

namespace {

constexpr double HOUR_S = 3600.0;
constexpr double SILENT_RATIO = 3.0;  // intervals of its frames
constexpr double ROUNDING_RAD2 = (0.01 * ARCSEC) * (0.01 * ARCSEC);
constexpr double HOTTEST_C =
    150.0;  // of electronics; in kelvin that would be colder than any head
constexpr double COLDEST_C = -273.15;
constexpr double LENGTH_ERROR = 1e-6;
constexpr int64_t RESTART_NS = 1'000'000'000;

constexpr double MEAN = 3.0;        // of the normalised innovation squared of an attitude
constexpr double FRAMES = 32.0;     // over which it is averaged
constexpr double SUSPICIOUS = 1.5;  // times that of the best other head; 5 sigma of the average
constexpr double GAIN = 1.0 / 48;  // slower than the average, so that the scale does not oscillate

enum Term { MISALIGNMENT, TEMPERATURE, COSINE, SINE };

double square(double x) {
    return x * x;
}

/// Return phi: 1, the temperature above the reference, cosine and sine of the orbit. The phase
/// counts from stamp 0, so that it lasts over a restart.
Vector<MOST_TERMS> basis(int64_t stamp_ns, double temperature_k, double period_s) {
    const double time_s = static_cast<double>(stamp_ns) * 1e-9;
    const double phase = 2 * M_PI * std::fmod(time_s, period_s) / period_s;
    return {{1.0, temperature_k, std::cos(phase), std::sin(phase)}};
}

/// Fill the terms of the law of a mount, and return how many there are. A law of the file counts,
/// whatever may be estimated in addition to it.
int terms_of(int index, const st_mount &mount, const st_mount_options &options, int *terms) {
    if (index == 0) {
        return 0;
    }
    bool has_law[3] = {};
    for (int row = 0; row < 3; ++row) {
        for (const double one : mount.law[row]) {
            has_law[row] = has_law[row] || (mount.has_law != 0 && one != 0);
        }
    }
    int count = 0;
    terms[count++] = MISALIGNMENT;
    if (options.mount_temperature_arcsec_k != 0 || has_law[0]) {
        terms[count++] = TEMPERATURE;
    }
    if (options.mount_orbit_arcsec != 0 || has_law[1] || has_law[2]) {
        terms[count++] = COSINE;
        terms[count++] = SINE;
    }
    return count;
}

}  // namespace

bool is_attitude(const HeadFrame &frame) {
    const Matrix3 &C = frame.covariance;
    // Written so that NaN is rejected. Sylvester's criterion.
    const double length = std::sqrt(dot(frame.quaternion, frame.quaternion));
    const double minor = C[0][0] * C[1][1] - C[0][1] * C[1][0];
    const double determinant = C[0][0] * (C[1][1] * C[2][2] - C[1][2] * C[2][1]) -
                               C[0][1] * (C[1][0] * C[2][2] - C[1][2] * C[2][0]) +
                               C[0][2] * (C[1][0] * C[2][1] - C[1][1] * C[2][0]);
    return std::fabs(length - 1) < LENGTH_ERROR && 0 < C[0][0] && C[0][0] < INFINITY &&
           0 < minor && minor < INFINITY && 0 < determinant && determinant < INFINITY;
}

bool HeadNoise::stands_out() const {
    return scale > SUSPICIOUS;
}

void HeadNoise::add(double frame_nis, double least) {
    const double gate = checks::HEAD_DIFFERS.threshold;
    nis += ((frame_nis > gate ? gate : frame_nis) - nis) / FRAMES;
    if (std::isnan(least)) {
        return;
    }
    const double ratio = nis / std::fmax(least, MEAN);
    if (ratio > SUSPICIOUS || scale > 1) {
        scale = std::fmax(1.0, scale * (1 + GAIN * (ratio - 1)));
    }
}

int Head::coefficients_of(int index, const st_mount &of, const st_mount_options &options) {
    int terms[MOST_TERMS];
    return 3 * terms_of(index, of, options, terms);
}

void Head::start(int index, const st_mount &of, const st_fusion_config &config, int first_column,
                 double *agreed) {
    number = index;
    mount = of;
    is_reference = index == 0;
    options_ = config.mount;
    correlation_s_ = config.fusion.correlation_s;
    term_count_ = terms_of(index, of, options_, terms_);
    columns = {first_column, 3 * term_count_};
    const Quaternion q = {of.quaternion[0], of.quaternion[1], of.quaternion[2], of.quaternion[3]};
    sensor_from_body_ = conjugate(q);
    body_from_sensor_ = matrix_from_quaternion(q);
    temperature_k_ = 0.0;
    needs_temperature = false;
    const double sigma[MOST_TERMS] = {
        options_.mount_sigma_arcsec * ARCSEC, options_.mount_temperature_arcsec_k * ARCSEC,
        options_.mount_orbit_arcsec * ARCSEC, options_.mount_orbit_arcsec * ARCSEC};
    prior_covariance_ = {};
    for (int t = 0; t < term_count_; ++t) {
        needs_temperature = needs_temperature || terms_[t] == TEMPERATURE;
        for (int i = 0; i < 3; ++i) {
            const int row = 3 * terms_[t] + i;
            prior_mean_[3 * t + i] =
                terms_[t] != MISALIGNMENT && of.has_law != 0 ? of.law[terms_[t] - 1][i] : 0.0;
            for (int s = 0; s < term_count_; ++s) {
                for (int k = 0; k < 3; ++k) {
                    const int column = 3 * terms_[s] + k;
                    double one = row == column ? square(sigma[terms_[t]]) : 0.0;
                    if (of.has_covariance != 0 && row < 3 && column < 3) {
                        one = of.covariance_rad2[row][column];
                    }
                    if (of.has_law_covariance != 0) {
                        one = of.law_covariance[row][column];
                    }
                    prior_covariance_[3 * t + i][3 * s + k] = one;
                }
            }
        }
    }
    agreed_ = agreed;
    agree_frames_ = config.fusion.agree_frames;
    counts = {};
    reset();
}

void Head::reset() {
    agreed_count_ = agreed_at_ = 0;
    enter(ST_HEAD_WAITING, reason_of(ST_HEAD_NO_FRAMES, {}));
    recent_count = 0;
    has_used = false;
    used_ns = 0;
    stepped_rad2 = 0.0;
    noise = {1.0, MEAN};
    first_ns_ = 0;
    stamp_count_ = stamp_at_ = 0;
    interval_s_ = 0.0;
}

void Head::enter(st_head_state next, const st_reason &why) {
    state = next;
    reason = why;
    clear_agreed();
    disagreed = 0;
}

// --- the mount ---

double Head::walk(int coefficient) const {
    return coefficient < 3 ? square(options_.mount_walk_arcsec_sqrt_h * ARCSEC) / HOUR_S : 0.0;
}

bool Head::is_plausible(const double *coefficients, int64_t stamp_ns) {
    if (is_reference) {
        return true;
    }
    const Sensitivity B = sensitivity(stamp_ns);
    first_ns_ = first_ns_ != 0 ? first_ns_ : stamp_ns;
    const int64_t since_ns = stamp_ns > first_ns_ ? stamp_ns - first_ns_ : first_ns_ - stamp_ns;
    const double walked = walk(0) * static_cast<double>(since_ns) * 1e-9;
    Vector3 difference{};
    Matrix<3, MOST_OWN> half{};
    for (int i = 0; i < 3; ++i) {
        for (int k = 0; k < columns.count; ++k) {
            difference[i] += B[i][k] * (coefficients[k] - prior_mean_[k]);
            for (int m = 0; m < columns.count; ++m) {
                half[i][m] += B[i][k] * prior_covariance_[k][m];
            }
        }
    }
    Matrix3 allowed{};
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            for (int m = 0; m < columns.count; ++m) {
                allowed[i][j] += half[i][m] * B[j][m];
            }
        }
        allowed[i][i] += walked + stepped_rad2 + ROUNDING_RAD2;
    }
    return dot(difference, inverse(allowed) * difference) <= checks::HEAD_DIFFERS.threshold;
}

bool Head::set_temperature(double celsius) {
    if (!(COLDEST_C <= celsius && celsius <= HOTTEST_C)) {
        return false;
    }
    needs_temperature = false;
    if (std::isnan(mount.temperature_c)) {
        mount.temperature_c = celsius;
    }
    temperature_k_ = celsius - mount.temperature_c;
    return true;
}

Sensitivity Head::sensitivity(int64_t stamp_ns) const {
    Sensitivity B{};
    if (term_count_ == 0) {
        return B;
    }
    Vector<MOST_TERMS> phi{{1.0}};
    if (term_count_ > 1) {
        phi = basis(stamp_ns, temperature_k_, options_.orbit_period_s);
    }
    for (int t = 0; t < term_count_; ++t) {
        for (int axis = 0; axis < 3; ++axis) {
            B[axis][3 * t + axis] = phi[terms_[t]];
        }
    }
    return B;
}

st_mount Head::estimated(const double *coefficients, const double *covariance, int stride) const {
    st_mount after = mount;
    after.has_covariance = is_reference ? 0 : 1;
    if (is_reference) {
        return after;
    }
    double whole[MOST_OWN] = {}, whole_covariance[MOST_OWN][MOST_OWN] = {};
    for (int t = 0; t < term_count_; ++t) {
        for (int i = 0; i < 3; ++i) {
            whole[3 * terms_[t] + i] = coefficients[3 * t + i];
            for (int s = 0; s < term_count_; ++s) {
                for (int k = 0; k < 3; ++k) {
                    whole_covariance[3 * terms_[t] + i][3 * terms_[s] + k] =
                        covariance[(3 * t + i) * stride + 3 * s + k];
                }
            }
        }
    }
    const Quaternion q = multiply(
        quaternion_from_rotation_vector({{whole[0], whole[1], whole[2]}}),
        {mount.quaternion[0], mount.quaternion[1], mount.quaternion[2], mount.quaternion[3]});
    const double turned[4] = {q.x, q.y, q.z, q.w};
    const bool law = term_count_ > 1;
    after.has_law = after.has_law_covariance = law ? 1 : 0;
    for (int i = 0; i < 4; ++i) {
        after.quaternion[i] = turned[i];
    }
    for (int i = 0; i < MOST_OWN; ++i) {
        if (i >= 3) {
            after.law[i / 3 - 1][i % 3] = law ? whole[i] : 0.0;
        }
        for (int k = 0; k < MOST_OWN; ++k) {
            after.law_covariance[i][k] = law ? whole_covariance[i][k] : 0.0;
            if (i < 3 && k < 3) {
                after.covariance_rad2[i][k] = whole_covariance[i][k];
            }
        }
    }
    return after;
}

// --- frames ---

bool Head::accept(HeadFrame &frame) {
    if (mount.time_offset_s != 0) {
        frame.stamp_ns -= std::llrint(mount.time_offset_s * 1e9);
    }
    for (int k = 0; k < stamp_count_; ++k) {
        if (stamps_[k] == frame.stamp_ns) {
            return false;
        }
    }
    if (stamp_count_ > 0) {
        const int64_t last_ns = stamps_[(stamp_at_ + REMEMBERED - 1) % REMEMBERED];
        const double step_s = std::fabs(static_cast<double>(frame.stamp_ns - last_ns)) * 1e-9;
        interval_s_ = stamp_count_ == 1
                          ? step_s
                          : interval_s_ + 0.2 * (std::fmin(step_s, 2 * interval_s_) - interval_s_);
    }
    stamps_[stamp_at_] = frame.stamp_ns;
    stamp_at_ = (stamp_at_ + 1) % REMEMBERED;
    stamp_count_ += stamp_count_ < REMEMBERED ? 1 : 0;
    double scale = noise.scale > 1 ? noise.scale : 1.0;
    if (correlation_s_ != 0 && interval_s_ != 0) {
        const double rho = std::exp(-interval_s_ / correlation_s_);
        scale *= (1 + rho) / (1 - rho);
    }
    for (int i = 0; scale != 1 && i < 3; ++i) {
        for (int k = 0; k < 3; ++k) {
            frame.covariance[i][k] *= scale;
        }
    }
    if (recent_count > 0 && recent[recent_count - 1].stamp_ns - frame.stamp_ns > RESTART_NS) {
        recent_count = 0;
    }
    // It is 0 to 2. NOLINTNEXTLINE(clang-analyzer-security.ArrayBound)
    if (recent_count == 0 || frame.stamp_ns > recent[recent_count - 1].stamp_ns) {
        if (recent_count == 2) {
            recent[0] = recent[1];
            recent_count = 1;
        }
        recent[recent_count++] = frame;
    }
    return true;
}

/// q_icrf_from_body = q_icrf_from_sensor q_sensor_from_body exp(-B c), and M C M^T, M body from
/// sensor.
HeadMeasurement Head::measurement(const HeadFrame &frame, const double *coefficients) const {
    HeadMeasurement measured{multiply(frame.quaternion, sensor_from_body_),
                             body_from_sensor_ * frame.covariance * transposed(body_from_sensor_),
                             columns, sensitivity(frame.stamp_ns)};
    if (columns.count > 0) {
        Vector3 misalignment{};
        for (int i = 0; i < 3; ++i) {
            for (int k = 0; k < columns.count; ++k) {
                misalignment[i] -= measured.B[i][k] * coefficients[k];
            }
        }
        measured.quaternion = turned(measured.quaternion, misalignment);
    }
    return measured;
}

bool Head::is_silent(int64_t stamp_ns, double gap_s) const {
    return !has_used || static_cast<double>(stamp_ns - used_ns) * 1e-9 >
                            std::fmax(gap_s, SILENT_RATIO * interval_s_);
}

bool Head::has_frames(int64_t stamp_ns, double gap_s) const {
    return recent_count > 0 &&
           std::fabs(static_cast<double>(stamp_ns - recent[recent_count - 1].stamp_ns)) * 1e-9 <=
               gap_s;
}

void Head::add_agreed(double nis) {
    agreed_[agreed_at_] = nis;
    agreed_at_ = (agreed_at_ + 1) % agree_frames_;
    agreed_count_ += agreed_count_ < agree_frames_ ? 1 : 0;
}

double Head::agreed_sum() const {
    double sum = 0.0;
    for (int k = agreed_count_; k > 0; --k) {
        sum += agreed_[(agreed_at_ + agree_frames_ - k) % agree_frames_];
    }
    return sum;
}

}  // namespace st
