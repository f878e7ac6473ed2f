// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "kernels_integrity.h"

#include <cstring>

#include "attitude/error_budget.h"
#include "attitude/error_ellipses.h"
#include "attitude/pointing.h"
#include "attitude/solution.h"
#include "attitude/triad.h"
#include "integrity/checks.h"
#include "integrity/expected_stars.h"
#include "integrity/gyro_agreement.h"
#include "integrity/lens_error.h"
#include "integrity/protection.h"
#include "integrity/row_pattern.h"
#include "integrity/stamp_jitter.h"
#include "integrity/systematic_errors.h"
#include "integrity/validation.h"
#include "maths/normal.h"
#include "maths/numbers.h"

using namespace st;

namespace {

/// Work memory of all functions; pages that none needs are never there.
alignas(ALIGNMENT) std::byte memory[size_t{1} << 26];

Arena arena_of_tests() {
    return {memory, sizeof(memory)};
}

/// Return an array of values that lie one after the other.
template <class T>
T *listed(const double *numbers, int count, Arena &arena) {
    T *list = arena.take<T>(static_cast<size_t>(count));
    std::memcpy(static_cast<void *>(list), numbers, sizeof(T) * static_cast<size_t>(count));
    return list;
}

Directions directions(const double *sensor, const double *icrf, const double *weight, int count,
                      Arena &arena) {
    return {count, listed<Vector3>(sensor, count, arena), listed<Vector3>(icrf, count, arena),
            listed<double>(weight, count, arena)};
}

int32_t put_reason(const st_reason &reason, double *figure) {
    std::memcpy(figure, reason.figure, sizeof(reason.figure));
    return reason.code;
}

Solution solution_of(const double *numbers, int count, double *residual_rad) {
    return {{},          count,       from<Quaternion>(numbers), from<Matrix3>(numbers + 4),
            numbers[13], residual_rad};
}

void put_solution(const Solution &solution, double *numbers) {
    into(numbers, solution.quaternion);
    into(numbers + 4, solution.covariance);
    numbers[13] = solution.chi2;
}

constexpr int STAR_NUMBERS = 15;

DetectedStar *detected(const double *star, int count, Arena &arena) {
    DetectedStar *stars = arena.take<DetectedStar>(static_cast<size_t>(count));
    for (int i = 0; i < count; ++i) {
        const double *s = star + STAR_NUMBERS * i;
        stars[i] = {
            i, {s[0], s[1]}, {s[2], s[3]}, {s[4], s[5], s[6]}, from<Flow>(s + 7), {s[13], s[14]}};
    }
    return stars;
}

FittedStars fitted(const double *sensor, const double *sigma_rad, const double *motion, int count,
                   Arena &arena) {
    return {count, listed<Vector3>(sensor, count, arena), sigma_rad,
            motion == nullptr ? nullptr : listed<Vector3>(motion, count, arena)};
}

AttitudeAt attitude_at(int64_t stamp_ns, const double *state) {
    return {stamp_ns, from<Quaternion>(state), from<Vector3>(state + 4)};
}

/// Return a validator that has accepted an attitude before, or none.
AttitudeValidator validator(const st_camera &camera, const st_trust_options &options,
                            const double *previous, Arena &arena) {
    AttitudeValidator made(lens_of(camera), options);
    if (previous != nullptr) {
        TrackedStar *stars = arena.take<TrackedStar>(static_cast<size_t>(options.min_stars));
        // From w > 0 to any sign by half of the turn.
        const auto last = from<Quaternion>(previous);
        const Quaternion half = normalised({last.x, last.y, last.z, last.w + 1});
        for (const Quaternion &q : {half, last}) {
            for (int i = 0; i < options.min_stars; ++i) {
                stars[i] = {{camera.cx_px, camera.cy_px},
                            matrix_from_quaternion(q) * Vector3{{0, 0, 1}},
                            1.0,
                            0.0};
            }
            made.check(q, identity<3>(), 0.0, stars, options.min_stars,
                       arena.take<double>(static_cast<size_t>(options.min_stars)), arena);
        }
    }
    return made;
}

int32_t put_trusted(const TrustedAttitude &attitude, double *figure, double *numbers) {
    into(numbers, attitude.quaternion);
    into(numbers + 4, attitude.covariance);
    numbers[13] = attitude.chi2;
    numbers[14] = attitude.residual_px;
    into(numbers + 15, attitude.protection_rad);
    return put_reason(attitude.reason, figure);
}

}  // namespace

double stt_two_sided_sigmas(double probability) {
    return two_sided_sigmas(probability);
}

// --- attitude ---

int32_t stt_solve(int32_t solver, const double *sensor, const double *icrf,
                  const double *sigma_rad, int32_t count, double *figure, double *solution,
                  double *residual_rad) {
    Arena arena = arena_of_tests();
    const Solution found =
        solve(static_cast<st_solver>(solver), listed<Vector3>(sensor, count, arena),
              listed<Vector3>(icrf, count, arena), sigma_rad, count, arena);
    put_solution(found, solution);
    if (found.reason.code == ST_NO_REASON) {
        std::memcpy(residual_rad, found.residual_rad, sizeof(double) * static_cast<size_t>(count));
    }
    return put_reason(found.reason, figure);
}

double stt_best_rotation(int32_t solver, const double *sensor, const double *icrf,
                         const double *weight, const double *sigma_rad, int32_t count,
                         double *matrix) {
    Arena arena = arena_of_tests();
    const Directions stars = directions(sensor, icrf, weight, count, arena);
    const BestRotation best = solver == ST_QUEST       ? quest(stars, sigma_rad)
                              : solver == ST_DAVENPORT ? davenport(stars)
                                                       : svd(stars);
    into(matrix, best.R);
    return best.gap;
}

void stt_triad(const double *sensor, const double *icrf, int32_t count, int32_t first,
               int32_t second, double *matrix) {
    Arena arena = arena_of_tests();
    into(matrix, triad({count, listed<Vector3>(sensor, count, arena),
                        listed<Vector3>(icrf, count, arena), nullptr},
                       first, second));
}

double stt_refine(const double *sensor, const double *icrf, const double *weight, int32_t count,
                  int32_t most_steps, double *matrix, double *covariance) {
    Arena arena = arena_of_tests();
    auto R = from<Matrix3>(matrix);
    const Covariance found = refine(R, directions(sensor, icrf, weight, count, arena), most_steps);
    into(matrix, R);
    into(covariance, found.P);
    return found.determinant;
}

double stt_cramer_rao(const double *sensor, const double *sigma_rad, int32_t count,
                      double *covariance) {
    Arena arena = arena_of_tests();
    const Covariance found = cramer_rao(listed<Vector3>(sensor, count, arena), sigma_rad, count);
    into(covariance, found.P);
    return found.determinant;
}

double stt_mean_chi2(const double *solution, const double *icrf, const double *sigma_rad,
                     int32_t count) {
    Arena arena = arena_of_tests();
    return mean_chi2(solution_of(solution, count, nullptr), listed<Vector3>(icrf, count, arena),
                     sigma_rad);
}

void stt_fit_error_ellipses(const st_camera *camera, const double *uv, const double *error,
                            const double *icrf, int32_t count, double *solution,
                            double *residual_rad) {
    Arena arena = arena_of_tests();
    Solution fitted_again = solution_of(solution, count, residual_rad);
    fit_error_ellipses(lens_of(*camera), listed<Point>(uv, count, arena),
                       listed<Covariance2>(error, count, arena),
                       listed<Vector3>(icrf, count, arena), fitted_again, arena);
    put_solution(fitted_again, solution);
}

void stt_pointing_covariance(const st_camera *camera, const double *common,
                             const double *rate_rad_s, double *covariance) {
    const Vector3 rate = rate_rad_s == nullptr ? Vector3{} : from<Vector3>(rate_rad_s);
    into(covariance, pointing_covariance(lens_of(*camera), from<Covariance2>(common),
                                         rate_rad_s == nullptr ? nullptr : &rate));
}

void stt_covariance_of(const st_budget *budget, double *covariance) {
    into(covariance, covariance_of(*budget));
}

// --- integrity ---

void stt_integrity_sizes(int32_t *bytes) {
    bytes[0] = static_cast<int32_t>(sizeof(LensError));
    bytes[1] = static_cast<int32_t>(sizeof(StampJitter));
}

double stt_fit_rows(const st_camera *camera, const double *star, int32_t count, double *pattern) {
    Arena arena = arena_of_tests();
    const RowFit fit = fit_rows(lens_of(*camera), detected(star, count, arena), count, arena);
    std::memcpy(pattern, fit.product, sizeof(fit.product));
    std::memcpy(pattern + 1 + STEPS, fit.energy, sizeof(fit.energy));
    std::memcpy(pattern + 2 + 2 * STEPS, fit.edge, sizeof(fit.edge));
    return fit.chi2;
}

int32_t stt_find_pattern(const st_camera *camera, const double *star, int32_t count,
                         double *memory_of_rows, double *figure) {
    Arena arena = arena_of_tests();
    double *m = memory_of_rows;
    RowPattern pattern{m[0], m[1], m[2], static_cast<int>(m[3])};
    const st_reason reason =
        find_pattern(lens_of(*camera), detected(star, count, arena), count, pattern, arena);
    m[0] = pattern.product;
    m[1] = pattern.energy;
    m[2] = pattern.excess;
    m[3] = pattern.frames;
    return put_reason(reason, figure);
}

int32_t stt_contradiction(const double *expected, int32_t count, const double *uv,
                          int32_t centroids, double present_px, double *figure) {
    Arena arena = arena_of_tests();
    return put_reason(
        contradiction_of(listed<ExpectedStar>(expected, count, arena), count,
                         listed<Point>(uv, centroids, arena), centroids, present_px, arena),
        figure);
}

int32_t stt_add_to_lens_error(const st_camera *camera, const int32_t *index, const double *star,
                              int32_t count, void *known_before, double *known) {
    Arena arena = arena_of_tests();
    auto &error = *static_cast<LensError *>(known_before);
    const bool first =
        add_frame(lens_of(*camera), index, detected(star, count, arena), count, error, arena);
    known[0] = error.value_px;
    known[1] = error.scale;
    known[2] = error.scale_sigma;
    return first;
}

void stt_start_jitter(void *known_before) {
    *static_cast<StampJitter *>(known_before) = start_jitter();
}

void stt_interrupt_jitter(void *known_before) {
    interrupt_jitter(*static_cast<StampJitter *>(known_before));
}

void stt_add_to_jitter(int64_t before_ns, int64_t stamp_ns, const double *before,
                       const double *predicted, const double *corrected, const double *turn,
                       const double *covariance, void *known_before, double *known) {
    auto &jitter = *static_cast<StampJitter *>(known_before);
    add_frame(attitude_at(before_ns, before), attitude_at(stamp_ns, predicted),
              attitude_at(stamp_ns, corrected), from<Vector3>(turn), from<Matrix3>(covariance),
              jitter);
    known[0] = jitter.sigma_s;
    into(known + 1, jitter.turn_rad);
}

void stt_compare_gyro(const double *options, const int64_t *rate_ns, const double *rate,
                      int32_t rates, const int64_t *frame_ns, const double *frame, int32_t frames,
                      int32_t *found) {
    Arena arena = arena_of_tests();
    Gyro gyro;
    gyro.start(gyro_model(from<st_gyro_options>(options)),
               arena.take<MeasuredRate>(static_cast<size_t>(rates)), rates);
    GyroAgreement agreement{};
    int next = 0;
    for (int k = 0; k < frames; ++k) {
        for (; next < rates && rate_ns[next] <= frame_ns[k]; ++next) {
            gyro.add(rate_ns[next], from<Vector3>(rate + 3 * next));
        }
        const double *f = frame + 25 * k;
        found[2 * k] = add_frame(gyro,
                                 {frame_ns[k], from<Quaternion>(f), from<Matrix3>(f + 4),
                                  from<Vector3>(f + 13), from<Matrix3>(f + 16)},
                                 agreement);
        found[2 * k + 1] = agreement.agreed;
    }
}

void stt_protection_level(const double *covariance, const double *star, int32_t count,
                          const double *probabilities, int32_t rejected, double *level) {
    Arena arena = arena_of_tests();
    into(level, protection_level(from<Matrix3>(covariance), listed<StarError>(star, count, arena),
                                 count, {probabilities[0], probabilities[1]}, rejected));
}

int32_t stt_is_covariance(const double *matrix) {
    return is_covariance(from<Matrix3>(matrix));
}

void stt_velocity_covariance(double sigma_m_s, const double *sensor, const double *sigma_rad,
                             int32_t count, double *covariance) {
    Arena arena = arena_of_tests();
    into(covariance,
         velocity_covariance(sigma_m_s, fitted(sensor, sigma_rad, nullptr, count, arena)));
}

void stt_lens_covariance(double lens_sigma_rad, double scale, const double *sensor,
                         const double *sigma_rad, int32_t count, double *covariance) {
    Arena arena = arena_of_tests();
    into(covariance,
         lens_covariance(lens_sigma_rad, scale, fitted(sensor, sigma_rad, nullptr, count, arena)));
}

void stt_epoch_covariance(const double *quaternion, double sigma_years, const double *sensor,
                          const double *sigma_rad, const double *motion, int32_t count,
                          double *covariance) {
    Arena arena = arena_of_tests();
    into(covariance, epoch_covariance(from<Quaternion>(quaternion), sigma_years,
                                      fitted(sensor, sigma_rad, motion, count, arena)));
}

int32_t stt_trust_stars(const st_camera *camera, const st_trust_options *options,
                        const double *star, int32_t count, double velocity_sigma_m_s,
                        double epoch_sigma_years, const double *previous, double *figure,
                        double *trusted) {
    Arena arena = arena_of_tests();
    return put_trusted(validator(*camera, *options, previous, arena)
                           .solve(listed<KnownStar>(star, count, arena), count,
                                  {velocity_sigma_m_s, epoch_sigma_years},
                                  arena.take<double>(static_cast<size_t>(count)), arena),
                       figure, trusted);
}

int32_t stt_trust_tracks(const st_camera *camera, const st_trust_options *options,
                         const double *quaternion, const double *covariance, double chi2,
                         const double *star, int32_t count, const double *previous, double *figure,
                         double *trusted) {
    Arena arena = arena_of_tests();
    return put_trusted(validator(*camera, *options, previous, arena)
                           .check(from<Quaternion>(quaternion), from<Matrix3>(covariance), chi2,
                                  listed<TrackedStar>(star, count, arena), count,
                                  arena.take<double>(static_cast<size_t>(count)), arena),
                       figure, trusted);
}
