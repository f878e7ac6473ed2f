// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "kernels_filter.h"

#include <cstring>

#include "camera/lens.h"
#include "filter/gyro.h"
#include "filter/motion.h"
#include "maths/numbers.h"
#include "track/correction.h"
#include "track/rolling_shutter.h"

using namespace st;

namespace {

/// Motions are larger than the stack of a test may be.
MotionWith<0> motion_of_tracker, spare_of_tracker;
MotionWith<MOST_CONSTANTS> motion_of_heads, spare_of_heads;
alignas(ALIGNMENT) std::byte memory[size_t{1} << 26];
alignas(ALIGNMENT) std::byte work_memory[size_t{1} << 26];
MeasuredRate ring[1 << 17];

template <int MOST>
void set_constants(Constants<MOST> &constants, int count) {
    if constexpr (MOST > 0) {
        constants.count = count;
    }
}

template <int MOST>
void read(const stt_state &from_state, int constants, StateWith<MOST> &state) {
    state = {};
    state.stamp_ns = from_state.stamp_ns;
    state.quaternion = from<Quaternion>(from_state.quaternion);
    state.rate_rad_s = from<Vector3>(from_state.rate);
    state.drift_rad_s = from<Vector3>(from_state.drift);
    set_constants(state.constants, constants);
    const int n = state.size();
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j < n; ++j) {
            state.covariance[i][j] = from_state.covariance[i * n + j];
        }
    }
}

template <int MOST>
void write(const StateWith<MOST> &state, stt_state &to) {
    to.stamp_ns = state.stamp_ns;
    into(to.quaternion, state.quaternion);
    into(to.rate, state.rate_rad_s);
    into(to.drift, state.drift_rad_s);
    const int n = state.size();
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j < n; ++j) {
            to.covariance[i * n + j] = state.covariance[i][j];
        }
    }
}

template <int MOST>
void read(const stt_motion &given, MotionWith<MOST> &motion) {
    motion.stamp_ns = given.stamp_ns;
    motion.quaternion = from<Quaternion>(given.quaternion);
    motion.weight = from<Weights>(given.weight);
    motion.share = from<Weights>(given.share);
    motion.noise_rad2 = from<Vector3>(given.noise);
    motion.interval_s = given.interval_s;
    motion.frames = given.frames;
    motion.jumps = from<Vector3>(given.jumps);
    motion.seen_jumps = given.seen_jumps;
    motion.swing = from<Swing>(given.swing);
    set_constants(motion.constants, given.constants);
    const int n = CONSTANT + given.constants;
    for (int j = 0; j < MODES; ++j) {
        for (int i = 0; i < n; ++i) {
            motion.mode[j].mean[i] = given.mean[j * n + i];
            for (int k = 0; k < n; ++k) {
                motion.mode[j].covariance[i][k] = given.covariance[(j * n + i) * n + k];
            }
        }
    }
}

template <int MOST>
void write(const MotionWith<MOST> &motion, stt_motion &to) {
    to.stamp_ns = motion.stamp_ns;
    into(to.quaternion, motion.quaternion);
    into(to.weight, motion.weight);
    into(to.share, motion.share);
    into(to.noise, motion.noise_rad2);
    to.interval_s = motion.interval_s;
    to.frames = motion.frames;
    into(to.jumps, motion.jumps);
    to.seen_jumps = motion.seen_jumps;
    into(to.swing, motion.swing);
    const int n = motion.size();
    for (int j = 0; j < MODES; ++j) {
        for (int i = 0; i < n; ++i) {
            to.mean[j * n + i] = motion.mode[j].mean[i];
            for (int k = 0; k < n; ++k) {
                to.covariance[(j * n + i) * n + k] = motion.mode[j].covariance[i][k];
            }
        }
    }
}

/// Call a function with the motion that was given, of one kind or the other, and with room for
/// another one.
template <class Function>
void with_motion(const stt_motion &given, Function function) {
    if (given.wide != 0 || given.constants > 0) {
        read(given, motion_of_heads);
        function(motion_of_heads, spare_of_heads);
    } else {
        read(given, motion_of_tracker);
        function(motion_of_tracker, spare_of_tracker);
    }
}

template <class Function>
void change(stt_motion *motion, Function function) {
    with_motion(*motion, [&]<int MOST>(MotionWith<MOST> &changed, MotionWith<MOST> &) {
        function(changed);
        write(changed, *motion);
    });
}

Gyro gyro_of(const stt_gyro &given) {
    Gyro gyro;
    gyro.start(gyro_model(*given.options), ring, given.capacity);
    for (int k = 0; k < given.count; ++k) {
        gyro.add(given.stamp_ns[k], from<Vector3>(given.rates + 3 * k));
    }
    return gyro;
}

AttitudeState tracked(const stt_state &given) {
    AttitudeState state;
    read(given, 0, state);
    return state;
}

Information information_of(int32_t size, const double *information, const double *vector) {
    Information measured{size, {}, {}};
    for (int i = 0; i < size; ++i) {
        measured.vector[i] = vector[i];
        for (int k = 0; k < size; ++k) {
            measured.information[i][k] = information[i * size + k];
        }
    }
    return measured;
}

}  // namespace

void stt_start_motion(stt_motion *motion, const stt_state *state, const double *constants,
                      const double noise[3], double interval_s) {
    change(motion, [&]<int MOST>(MotionWith<MOST> &changed) {
        StateWith<MOST> of;
        read(*state, motion->constants, of);
        start_motion(of, constants, from<Vector3>(noise), interval_s, changed);
    });
}

void stt_restart_motion(stt_motion *motion, const stt_state *state) {
    change(motion, [&]<int MOST>(MotionWith<MOST> &changed) {
        StateWith<MOST> of;
        read(*state, motion->constants, of);
        restart_motion(of, changed);
    });
}

void stt_resume_motion(stt_motion *motion, const stt_motion *known) {
    with_motion(*motion, [&](auto &changed, auto &spare) {
        read(*known, spare);
        resume_motion(spare, changed);
        write(changed, *motion);
    });
}

void stt_interrupt_motion(stt_motion *motion) {
    change(motion, [](auto &changed) { interrupt_motion(changed); });
}

void stt_predict_motion(stt_motion *motion, int64_t to_ns, int32_t count, const double *dt_s,
                        const double *rates, const double *variance, const double acceleration[3],
                        const double *walk) {
    with_motion(*motion, [&]<int MOST>(MotionWith<MOST> &before, MotionWith<MOST> &after) {
        GyroRates measured = no_rates(dt_s[0]);
        measured.count = count;
        for (int k = 0; k < count; ++k) {
            measured.dt_s[k + 1] = dt_s[k + 1];
            measured.rate_rad_s[k] = from<Vector3>(rates + 3 * k);
            measured.variance[k] = variance[k];
        }
        ProcessNoise<MOST> noise{from<Vector3>(acceleration), {}};
        for (int k = 0; k < 3 + motion->constants; ++k) {
            noise.walk[k] = walk[k];
        }
        predict_motion(before, to_ns, measured, noise, after);
        write(after, *motion);
    });
}

void stt_update_motion(stt_motion *motion, const double quaternion[4], const double rate[3],
                       int32_t size, const double *information, const double *vector,
                       const double *beside, const double *moved) {
    change(motion, [&]<int MOST>(MotionWith<MOST> &changed) {
        MotionMeasurement<MOST> measured{};
        measured.quaternion = from<Quaternion>(quaternion);
        measured.rate_rad_s = from<Vector3>(rate);
        measured.stars = information_of(size, information, vector);
        const int columns = CONSTANT - ACCELERATION + motion->constants;
        for (int i = 0; i < size; ++i) {
            measured.moved[i] = moved[i];
            for (int k = 0; k < columns; ++k) {
                measured.beside[i][k] = beside[i * columns + k];
            }
        }
        update_motion(measured, changed);
    });
}

void stt_measure_motion(stt_motion *motion, int64_t before_ns, const double quaternion[4],
                        const double R[9]) {
    change(motion, [&](auto &changed) {
        measure_motion(before_ns, from<Quaternion>(quaternion), from<Matrix3>(R), changed);
    });
}

void stt_state_of(const stt_motion *motion, const double weight[9], stt_state *state,
                  double *constants) {
    with_motion(*motion, [&](auto &given, auto &) {
        write(state_of(given, from<Weights>(weight)), *state);
        constants_of(given, from<Weights>(weight), constants);
    });
}

void stt_acceleration_of(const stt_motion *motion, double acceleration[3]) {
    with_motion(*motion, [&](auto &given, auto &) { into(acceleration, acceleration_of(given)); });
}

void stt_with_tails(const stt_motion *motion, double covariance[36]) {
    with_motion(*motion, [&](auto &given, auto &) {
        into(covariance, with_tails(given, from<Matrix<6, 6>>(covariance)));
    });
}

void stt_vibration_covariance(const stt_motion *motion, double covariance[36]) {
    read(*motion, motion_of_tracker);
    into(covariance, vibration_covariance(motion_of_tracker));
}

void stt_course_of(const stt_motion *motion, const double acceleration[3], double course[12]) {
    read(*motion, motion_of_tracker);
    into(course, course_of(motion_of_tracker, from<Vector3>(acceleration)));
}

void stt_by_experience(const double weight[9], const double share[9], double seen[9]) {
    into(seen, by_experience(from<Weights>(weight), from<Weights>(share)));
}

double stt_tail_sigmas(double probability, double missed) {
    return tail_sigmas(probability, missed);
}

void stt_covariance_deficit(const double covariance[9], const double error[3], double across,
                            double probability, double deficit[9]) {
    into(deficit,
         covariance_deficit(from<Matrix3>(covariance), from<Vector3>(error), across, probability));
}

void stt_with_measured(stt_state *state, int32_t size, const double *information,
                       const double *vector) {
    write(with_measured(tracked(*state), information_of(size, information, vector)), *state);
}

void stt_with_new_drift(stt_state *state, double sigma_rad_s) {
    write(with_new_drift(tracked(*state), sigma_rad_s), *state);
}

void stt_gyro_model(const stt_gyro *gyro, double model[5]) {
    into(model, gyro_model(*gyro->options));
}

int32_t stt_gyro_count(const stt_gyro *gyro) {
    return gyro_of(*gyro).count();
}

double stt_gyro_silent_s(const stt_gyro *gyro, int64_t stamp_ns) {
    return gyro_of(*gyro).silent_s(stamp_ns);
}

int32_t stt_gyro_is_saturated(const stt_gyro *gyro, int64_t stamp_ns, double for_s) {
    return gyro_of(*gyro).is_saturated(stamp_ns, for_s);
}

void stt_gyro_propagate(const stt_gyro *gyro, int32_t constants, stt_state *state, int64_t to_ns) {
    if (constants == 0) {
        write(gyro_of(*gyro).propagated(tracked(*state), to_ns), *state);
    } else {
        StateWith<MOST_CONSTANTS> given;
        read(*state, constants, given);
        write(gyro_of(*gyro).propagated(given, to_ns), *state);
    }
}

void stt_gyro_predict(const stt_gyro *gyro, stt_state *state, int64_t to_ns,
                      stt_state *predicted) {
    AttitudeState given = tracked(*state);
    write(gyro_of(*gyro).predicted(given, to_ns), *predicted);
    write(given, *state);
}

int32_t stt_gyro_rates(const stt_gyro *gyro, int64_t from_ns, int64_t to_ns, double *dt_s,
                       double *rates, double *variance) {
    const GyroRates found = gyro_of(*gyro).rates(from_ns, to_ns);
    std::memcpy(dt_s, found.dt_s, sizeof(found.dt_s));
    std::memcpy(rates, found.rate_rad_s, sizeof(found.rate_rad_s));
    std::memcpy(variance, found.variance, sizeof(found.variance));
    return found.count;
}

void stt_gyro_mean_rate(const stt_gyro *gyro, int64_t from_ns, int64_t to_ns,
                        double rate_and_variance[4]) {
    into(rate_and_variance, gyro_of(*gyro).mean_rate(from_ns, to_ns));
}

void stt_correct(const st_camera *camera, const double *icrf, const int32_t *usable, int32_t stars,
                 int32_t min_stars, double outlier_sigmas, const stt_state *predicted,
                 const double *centroid, int32_t centroids, const double detection[4],
                 stt_correction *to) {
    Arena arena(memory, sizeof(memory)), work(work_memory, sizeof(work_memory));
    const auto n = static_cast<size_t>(stars), m = static_cast<size_t>(centroids);
    auto *direction = arena.take<Vector3>(n);
    auto *may_correct = arena.take<bool>(n);
    auto *uv = arena.take<Point>(m);
    auto *error = arena.take<Covariance2>(m);
    auto *delay_s = arena.take<double>(m);
    for (int k = 0; k < stars; ++k) {
        direction[k] = from<Vector3>(icrf + 3 * k);
        may_correct[k] = usable[k] != 0;
    }
    for (int j = 0; j < centroids; ++j) {
        const double *c = centroid + 6 * j;
        uv[j] = {c[0], c[1]};
        error[j] = {c[2], c[3], c[4]};
        delay_s[j] = c[5];
    }
    const Correction found =
        correct(lens_of(*camera), {stars, direction, may_correct}, {min_stars, outlier_sigmas},
                tracked(*predicted), {centroids, uv, error}, delay_s,
                {detection[0], detection[1], detection[2], detection[3]}, arena, work);
    to->agreed = found.agreed;
    to->count = found.count;
    to->stars = found.stars;
    to->inliers = found.inliers;
    to->size = found.measured.size;
    for (int k = 0; k < found.count; ++k) {
        to->star[k] = found.star[k];
        to->best[k] = found.best[k];
        to->inlier[k] = found.inlier[k];
        to->predicted[2 * k] = found.predicted[k].x;
        to->predicted[2 * k + 1] = found.predicted[k].y;
        to->distance_px[k] = found.distance_px[k];
        to->normalised[k] = found.normalised[k];
        double *row = to->probability + k * (centroids + 1);
        std::memset(row, 0, (m + 1) * sizeof(double));
        row[0] = found.association.missed[k];
        for (auto *one = found.association.begin(k); one < found.association.end(k); ++one) {
            row[1 + one->centroid] = one->value;
        }
    }
    for (int j = 0; j < centroids; ++j) {
        to->unassociated[j] = found.association.unassociated[j];
    }
    write(found.state, to->state);
    into(to->information, found.measured.information);
    into(to->vector, found.measured.vector);
    into(to->by_acceleration, found.by_acceleration);
    into(to->turn, found.turn);
    into(to->turn_covariance, found.turn_covariance);
    into(to->innovation, found.innovation);
    to->residual_px = found.residual_px;
    to->chi2 = found.chi2;
    to->typical = found.typical;
    to->precise = found.precise;
}

void stt_on_image(const st_camera *camera, const double *icrf, int32_t count,
                  const stt_state *state, double *states, double *covariances) {
    const Lens lens = lens_of(*camera);
    const AttitudeState of = tracked(*state);
    const Matrix3 R = matrix_from_quaternion(of.quaternion);
    for (int k = 0; k < count; ++k) {
        const ImageMotion star = on_image(lens, R, from<Vector3>(icrf + 3 * k), of);
        into(states + 4 * k, star.state);
        into(covariances + 16 * k, star.covariance);
    }
}

void stt_at_frame_time(const st_camera *camera, const double *uv, const double *delay_s,
                       int32_t count, const double rate[3], const double acceleration[3],
                       double *moved) {
    const Lens lens = lens_of(*camera);
    for (int k = 0; k < count; ++k) {
        into(moved + 2 * k, at_frame_time(lens, from<Point>(uv + 2 * k), delay_s[k],
                                          from<Vector3>(rate), from<Vector3>(acceleration)));
    }
}

int32_t stt_fit_rate(const st_camera *camera, const double *icrf, const double *uv,
                     const double *sigma_px, const double *delay_s, int32_t count,
                     const double quaternion[4], double rate[3]) {
    Arena arena(memory, sizeof(memory));
    auto *direction = arena.take<Vector3>(static_cast<size_t>(count));
    auto *pixel = arena.take<Point>(static_cast<size_t>(count));
    for (int k = 0; k < count; ++k) {
        direction[k] = from<Vector3>(icrf + 3 * k);
        pixel[k] = from<Point>(uv + 2 * k);
    }
    Vector3 fitted{};
    const bool is_there = fit_rate(lens_of(*camera), {count, direction, pixel, sigma_px, delay_s},
                                   from<Quaternion>(quaternion), fitted);
    into(rate, fitted);
    return is_there;
}
