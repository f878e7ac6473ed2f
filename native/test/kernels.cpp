// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "kernels.h"

#include <cstring>

#include "camera/lens.h"
#include "centroid/connected.h"
#include "centroid/exposure.h"
#include "centroid/hits.h"
#include "centroid/noise_fit.h"
#include "centroid/point_stars.h"
#include "centroid/pointing_error.h"
#include "centroid/psf_sigma.h"
#include "centroid/shape.h"
#include "centroid/spots.h"
#include "centroid/streak_search.h"
#include "centroid/streak_stars.h"
#include "maths/gates.h"
#include "maths/numbers.h"
#include "maths/rotation.h"
#include "maths/symmetric.h"
#include "sky/sky.h"

using namespace st;

namespace {

template <int N>
int32_t factored(const double *symmetric, const double *right, double *lower, double *solution) {
    Matrix<N, N> L;
    if (!cholesky(from<Matrix<N, N>>(symmetric), L)) {
        return 0;
    }
    into(lower, L);
    into(solution, solved(L, from<Matrix<N, 2>>(right)));
    return 1;
}

/// Return a function of the upper left 3 x 3 block.
template <class Function>
auto of_size(int32_t size, const double *symmetric, Function function) {
    if (size == 3) {
        return function(from<Matrix<3, 3>>(symmetric));
    }
    return size == 6 ? function(from<Matrix<6, 6>>(symmetric))
                     : function(from<Matrix<9, 9>>(symmetric));
}

SkyFile opened(const st_sky *file) {
    SkyFile sky;
    open_sky(*file, sky, nullptr);
    return sky;
}

/// Work memory of all functions; pages that none needs are never there.
alignas(ALIGNMENT) std::byte memory[size_t{1} << 28];

Arena arena_of_tests() {
    return {memory, sizeof(memory)};
}

Frame frame_of(const stt_frame &given, Arena &arena) {
    const size_t tiles = static_cast<size_t>((given.tile_rows + 2) * (given.tile_columns + 2));
    Frame frame{};
    frame.image = {given.pixel, given.width, given.height, given.width, 16};
    frame.kernel = gaussian_kernel(given.filter_sigma_px);
    frame.mesh = {arena.take<double>(tiles), arena.take<double>(tiles), given.tile_rows,
                  given.tile_columns,        given.median_level,        given.median_noise,
                  given.tiles_down,          given.tiles_across};
    std::memcpy(frame.mesh.level, given.level, tiles * sizeof(double));
    std::memcpy(frame.mesh.noise, given.noise, tiles * sizeof(double));
    frame.search.peaks = arena.list<Peak>(static_cast<size_t>(given.peaks));
    for (int k = 0; k < given.peaks; ++k) {
        const double *p = given.peak + 7 * k;
        frame.search.peaks.add(
            {static_cast<int>(p[0]), static_cast<int>(p[1]), p[2], p[3], p[4], p[5], p[6]});
    }
    frame.full_scale_dn = given.full_scale_dn;
    return frame;
}

/// Copy the pixels of a window, without those that fill up its rows.
void put(const float *from, const Window &window, int i, float *to) {
    for (int y = 0; y < window.count; ++y) {
        std::memcpy(to + (i * window.count + y) * window.count, from + y * window.filled,
                    static_cast<size_t>(window.count) * sizeof(float));
    }
}

template <int P>
void fit_windows(stt_windows &given) {
    Arena arena = arena_of_tests();
    const int count = given.count, side = given.side;
    const auto n = static_cast<size_t>(count);
    FitWork &work = *arena.take<FitWork>(1);
    auto *fit = arena.take<Fit<P>>(n);
    auto *corner = arena.take<Pixel>(n);
    for (int i = 0; i < count; ++i) {
        fit[i].star = from<Star>(given.star + 5 * i);
        corner[i] = {given.corner[2 * i], given.corner[2 * i + 1]};
    }
    const Neighbours neighbours(corner, count, side, arena);
    const NoiseModel noise{given.gain_dn, given.model_error};
    const int filled = (side + LANES - 1) / LANES * LANES;
    NoiseFit noise_fit(count, side * filled, arena);
    const auto cut = [&](int i, Window &window) {
        window.count = side;
        window.filled = filled;
        window.left = corner[i].u;
        window.top = corner[i].v;
        window.variance = given.variance[i];
        std::memset(window.data, 0, sizeof(window.data));
        std::memset(window.used, 0, sizeof(window.used));
        for (int y = 0; y < side; ++y) {
            const int at = (i * side + y) * side;
            std::memcpy(window.data + y * filled, given.data + at,
                        static_cast<size_t>(side) * sizeof(float));
            std::memcpy(window.used + y * filled, given.used + at,
                        static_cast<size_t>(side) * sizeof(float));
        }
    };
    const auto use = [&](int i) {
        put(work.model, work.window, i, given.model);
        put(work.own, work.window, i, given.own);
        put(work.weight, work.window, i, given.weight);
        if constexpr (P == 4) {
            noise_fit.add(i, fit[i], work);
        }
        const SpotMoments m = spot_moments(fit[i].star, work);
        const Width width = test_width(fit[i].star, fit[i].chi2, work);
        const double shape[6] = {m.straight, m.oblique,          m.size,
                                 m.variance, 1.0 * width.narrow, 1.0 * width.wide};
        std::memcpy(given.shape + 6 * i, shape, sizeof(shape));
    };
    fit_stars(fit, count, neighbours, noise, given.iterations, cut, use, work);
    for (int i = 0; i < count; ++i) {
        into(given.star + 5 * i, fit[i].star);
        into(given.covariance + P * P * i, fit[i].covariance);
        given.chi2[i] = fit[i].chi2;
        given.dof[i] = fit[i].dof;
    }
    const NoiseModel refined = noise_fit.refined(noise, [](int) { return true; });
    given.noise[0] = refined.gain_dn;
    given.noise[1] = refined.model_error;
}

template <int P>
StreakFit<P> *streak_fits(const double *star, int count, Arena &arena) {
    auto *fit = arena.take<StreakFit<P>>(static_cast<size_t>(count));
    for (int i = 0; i < count; ++i) {
        fit[i].star = from<StreakStar>(star + 7 * i);
    }
    return fit;
}

Sky *skies_of(const double *sky, int count, Arena &arena) {
    auto *skies = arena.take<Sky>(static_cast<size_t>(count));
    for (int i = 0; i < count; ++i) {
        skies[i] = from<Sky>(sky + 4 * i);
    }
    return skies;
}

template <int P>
void fit_streaks_of(const stt_frame &given, const double *sky, double *star, double *covariance,
                    double *chi2, double *dof, int count, double gain_dn, int iterations) {
    Arena arena = arena_of_tests();
    const Frame frame = frame_of(given, arena);
    StreakFit<P> *fit = streak_fits<P>(star, count, arena);
    const StreakPixels pixels{frame.image, frame.full_scale_dn, skies_of(sky, count, arena)};
    fit_streaks(pixels, fit, count, {gain_dn}, iterations, arena);
    for (int i = 0; i < count; ++i) {
        into(star + 7 * i, fit[i].star);
        into(covariance + P * P * i, fit[i].covariance);
        chi2[i] = fit[i].chi2;
        dof[i] = fit[i].dof;
    }
}

/// Lists in arrays of the caller.
template <class T>
List<T> list_in(T *item, int capacity) {
    return {item, 0, capacity, 0};
}

}  // namespace

extern "C" {

void stt_multiply(const double a[4], const double b[4], double product[4]) {
    into(product, multiply(from<Quaternion>(a), from<Quaternion>(b)));
}

void stt_quaternion_from_rotation_vector(const double rotation[3], double q[4]) {
    into(q, quaternion_from_rotation_vector(from<Vector3>(rotation)));
}

void stt_rotation_vector_from_quaternion(const double q[4], double rotation[3]) {
    into(rotation, rotation_vector_from_quaternion(from<Quaternion>(q)));
}

void stt_matrix_from_quaternion(const double q[4], double matrix[9]) {
    into(matrix, matrix_from_quaternion(from<Quaternion>(q)));
}

void stt_quaternion_from_matrix(const double matrix[9], double q[4]) {
    into(q, quaternion_from_matrix(from<Matrix3>(matrix)));
}

void stt_turned(const double q[4], const double rotation[3], double after[4]) {
    into(after, turned(from<Quaternion>(q), from<Vector3>(rotation)));
}

void stt_turn_matrix(const double matrix[9], const double g[3], double after[9]) {
    into(after, turn_matrix(from<Matrix3>(matrix), from<Vector3>(g)));
}

void stt_attitude_error(const double estimate[4], const double truth[4], double error[3]) {
    into(error, attitude_error(from<Quaternion>(estimate), from<Quaternion>(truth)));
}

void stt_quaternion_from_axes(const double z[3], const double towards_y[3], double q[4]) {
    into(q, quaternion_from_axes(from<Vector3>(z), from<Vector3>(towards_y)));
}

void stt_covariance_icrf(const double q[4], const double sensor[9], double icrf[9]) {
    into(icrf, covariance_icrf(from<Quaternion>(q), from<Matrix3>(sensor)));
}

void stt_matrix_from_rotation_vector(const double rotation[3], double matrix[9]) {
    into(matrix, matrix_from_rotation_vector(from<Vector3>(rotation)));
}

void stt_sign_continuous(const double q[4], const double previous[4], double continuous[4]) {
    into(continuous, sign_continuous(from<Quaternion>(q), from<Quaternion>(previous)));
}

void stt_sensor_direction(const double matrix[9], const double icrf[3], double sensor[3]) {
    into(sensor, sensor_direction(from<Matrix3>(matrix), from<Vector3>(icrf)));
}

double stt_angle_between(const double a[3], const double b[3]) {
    return angle_between(from<Vector3>(a), from<Vector3>(b));
}

double stt_determinant(int32_t size, const double *symmetric) {
    return of_size(size, symmetric, [](const auto &A) { return determinant(A); });
}

void stt_inverse(int32_t size, const double *symmetric, double inverse[9]) {
    into(inverse, of_size(size, symmetric, [](const auto &A) { return st::inverse(A); }));
}

int32_t stt_is_positive_definite(int32_t size, const double *symmetric) {
    return of_size(size, symmetric, [](const auto &A) { return is_positive_definite(A); }) ? 1 : 0;
}

int32_t stt_cholesky(int32_t size, const double *symmetric, const double *right, double *lower,
                     double *solution) {
    if (size == 3) {
        return factored<3>(symmetric, right, lower, solution);
    }
    return size == 6 ? factored<6>(symmetric, right, lower, solution)
                     : factored<9>(symmetric, right, lower, solution);
}

double stt_gate(double probability, double dof) {
    return gate(probability, dof);
}

double stt_corner_angle(const st_camera *camera) {
    return corner_angle(lens_of(*camera));
}

int32_t stt_shows(const st_camera *camera, const double pixel[2]) {
    return shows(lens_of(*camera), from<Point>(pixel)) ? 1 : 0;
}

void stt_middle_axes(const st_camera *camera, double q[4]) {
    into(q, middle_axes(lens_of(*camera)));
}

int32_t stt_stars_in_cone(const st_sky *file, const double axis[3], double radius_rad,
                          int32_t *index, int32_t capacity) {
    return stars_in_cone(opened(file), from<Vector3>(axis), radius_rad, index, capacity);
}

int32_t stt_nearest_star(const st_sky *file, const double direction[3], double chord,
                         double *square) {
    return nearest_star(opened(file), from<Vector3>(direction), chord, *square);
}

void stt_direction_at(const st_sky *file, int32_t star, double years, const double moved_au[3],
                      double direction[3]) {
    into(direction, direction_at(opened(file), star, years, from<Vector3>(moved_au)));
}

void stt_pairs_between(const st_sky *file, int32_t bright, double low_rad, double high_rad,
                       int32_t range[2]) {
    const SkyFile sky = opened(file);
    const PairRange found =
        pairs_between(bright != 0 ? sky.bright_pairs : sky.pairs, low_rad, high_rad);
    range[0] = found.first;
    range[1] = found.end;
}

void stt_profile(double centre, double sigma, int32_t first, int32_t count, double *share) {
    Profile<double> of;
    profile(centre, sigma, first, count, of);
    const size_t bytes = static_cast<size_t>(count) * sizeof(double);
    std::memcpy(share, of.share, bytes);
    std::memcpy(share + count, of.d_centre, bytes);
    std::memcpy(share + 2 * count, of.d_sigma, bytes);
}

void stt_cut_windows(const stt_frame *given, double sigma_px, stt_windows *windows) {
    Arena arena = arena_of_tests();
    const Frame frame = frame_of(*given, arena);
    Window &window = *arena.take<Window>(1);
    for (int i = 0; i < given->peaks; ++i) {
        cut_window(frame, frame.search.peaks[i], window_radius(sigma_px), window);
        put(window.data, window, i, windows->data);
        put(window.used, window, i, windows->used);
        windows->corner[2 * i] = window.left;
        windows->corner[2 * i + 1] = window.top;
        windows->variance[i] = window.variance;
        into(windows->star + 5 * i, initial_star(frame.kernel, frame.search.peaks[i], sigma_px));
    }
}

void stt_fit_windows(stt_windows *windows) {
    if (windows->free == 4) {
        fit_windows<4>(*windows);
    } else {
        fit_windows<5>(*windows);
    }
}

int32_t stt_measure_points(const stt_frame *given, double sigma_px, int32_t method,
                           const double segmentation[3], double threshold_sigmas, int32_t most,
                           st_centroid *stars, int32_t *count, st_rejected *rejected,
                           int32_t *rejected_count) {
    Arena arena = arena_of_tests();
    const Frame frame = frame_of(*given, arena);
    List<st_centroid> found = list_in(stars, *count);
    Rejections rejections;
    rejections.spots = list_in(rejected, *rejected_count);
    const PointOptions options{static_cast<st_centroid_method>(method),
                               {segmentation[0], segmentation[1] != 0, segmentation[2]},
                               threshold_sigmas};
    // As much memory as is said to be needed, and no more.
    const size_t bytes = points_bytes(given->peaks);
    Arena work(arena.take<std::byte>(bytes), bytes);
    const bool smeared = measure_points(frame, frame.search.peaks.item, given->peaks, sigma_px,
                                        options, most, found, rejections, work);
    *count = found.count;
    *rejected_count = rejections.spots.count;
    return smeared ? 1 : 0;
}

int32_t stt_psf_sigma(const stt_frame *given, int32_t narrow, double *sigma_px) {
    Arena arena = arena_of_tests();
    const Frame frame = frame_of(*given, arena);
    Arena work(arena.take<std::byte>(psf_sigma_bytes()), psf_sigma_bytes());
    const PsfSigma found = measure_psf_sigma(frame, narrow != 0, work);
    *sigma_px = found.sigma_px;
    return found.is_certain ? 1 : 0;
}

void stt_fit_streaks(const stt_frame *frame, const double *sky, double *star, double *covariance,
                     double *chi2, double *dof, int32_t count, int32_t free, double gain_dn,
                     int32_t iterations) {
    const auto fitted = free == 4 ? fit_streaks_of<4> : fit_streaks_of<7>;
    fitted(*frame, sky, star, covariance, chi2, dof, count, gain_dn, iterations);
}

double stt_photon_gain(const stt_frame *given, const double *sky, const double *star,
                       int32_t count, double gain_dn) {
    Arena arena = arena_of_tests();
    const Frame frame = frame_of(*given, arena);
    const StreakPixels pixels{frame.image, frame.full_scale_dn, skies_of(sky, count, arena)};
    return photon_gain(pixels, streak_fits<4>(star, count, arena), count, {gain_dn});
}

double stt_streak_flux(const stt_frame *given, const double sky[4], const double star[7]) {
    Arena arena = arena_of_tests();
    const Frame frame = frame_of(*given, arena);
    const StreakPixels pixels{frame.image, frame.full_scale_dn, skies_of(sky, 1, arena)};
    return flux_at(pixels, 0, from<StreakStar>(star));
}

double stt_streak_share(const double star[7], double x, double y) {
    return StreakShape(from<StreakStar>(star)).share_at(x, y);
}

void stt_fit_streak(const double *places, const double *streaks, const double *weight,
                    int32_t count, int32_t width, int32_t height, double streak[5]) {
    Arena arena = arena_of_tests();
    auto *uv = arena.take<Place>(static_cast<size_t>(count));
    auto *moved = arena.take<Place>(static_cast<size_t>(count));
    for (int i = 0; i < count; ++i) {
        uv[i] = {places[2 * i], places[2 * i + 1]};
        moved[i] = {streaks[2 * i], streaks[2 * i + 1]};
    }
    into(streak, fit_streak(uv, moved, weight, count, width, height));
}

void stt_joined(const double one[5], const double other[5], double joined[5]) {
    into(joined, from<Streak>(one).joined(from<Streak>(other)));
}

int32_t stt_estimate_streak(const stt_frame *given, double start_px, double streak[5],
                            double *sigma_px) {
    Arena arena = arena_of_tests();
    const Frame frame = frame_of(*given, arena);
    const size_t bytes = streak_search_bytes(given->width, given->height);
    Arena work(arena.take<std::byte>(bytes), bytes);
    const FoundStreak found = estimate_streak(frame, start_px, work);
    into(streak, found.streak);
    *sigma_px = found.sigma_px;
    return found.is_found ? 1 : 0;
}

int32_t stt_search_streaks(const stt_frame *given, const double streak[5], double sigma_px,
                           double threshold_sigmas, double *places) {
    Arena arena = arena_of_tests();
    const Frame frame = frame_of(*given, arena);
    auto *found = arena.take<Place>(MOST_STREAK_PEAKS);
    const size_t bytes = streak_search_bytes(given->width, given->height);
    Arena work(arena.take<std::byte>(bytes), bytes);
    const int count =
        search_streaks(frame, from<Streak>(streak), sigma_px, threshold_sigmas, found, work);
    for (int i = 0; i < count; ++i) {
        into(places + 2 * i, found[i]);
    }
    return count;
}

void stt_measure_streaks(const stt_frame *given, const double *places, int32_t places_count,
                         const double streak[5], double sigma_px, double threshold_sigmas,
                         st_centroid *stars, int32_t *count, st_rejected *rejected,
                         int32_t *rejected_count) {
    Arena arena = arena_of_tests();
    const Frame frame = frame_of(*given, arena);
    auto *uv = arena.take<Place>(static_cast<size_t>(places_count));
    for (int i = 0; i < places_count; ++i) {
        uv[i] = {places[2 * i], places[2 * i + 1]};
    }
    List<st_centroid> found = list_in(stars, *count);
    Rejections rejections;
    rejections.spots = list_in(rejected, *rejected_count);
    const size_t bytes = streak_stars_bytes(places_count);
    Arena work(arena.take<std::byte>(bytes), bytes);
    measure_streaks(frame, uv, places_count, from<Streak>(streak), sigma_px, threshold_sigmas,
                    found, rejections, work);
    *count = found.count;
    *rejected_count = rejections.spots.count;
}

void stt_pointing_error(const stt_frame *given, const double *star, int32_t count,
                        int32_t streaked, double covariance[4]) {
    Arena arena = arena_of_tests();
    const Frame frame = frame_of(*given, arena);
    auto *stars = arena.take<StreakStar>(static_cast<size_t>(count));
    for (int i = 0; i < count; ++i) {
        stars[i] = from<StreakStar>(star + 7 * i);
    }
    Arena work(arena.take<std::byte>(pointing_error_bytes()), pointing_error_bytes());
    into(covariance, pointing_error(frame.image, frame.mesh, frame.full_scale_dn, stars, count,
                                    streaked != 0, work));
}

void stt_filter(const uint16_t *image, int32_t width, int32_t height, double sigma_px,
                double *by_rows, double *by_pixels, double *noise_gain) {
    Arena arena = arena_of_tests();
    const Kernel kernel = gaussian_kernel(sigma_px);
    const Image whole{image, width, height, width, 16};
    auto *line = arena.take<float>(static_cast<size_t>(width + 2 * MOST_WEIGHTS));
    auto *row = arena.take<float>(static_cast<size_t>(width));
    for (int v = 0; v < height; ++v) {
        const uint16_t *rows[2 * MOST_WEIGHTS];
        for (int k = 0; k <= 2 * kernel.radius; ++k) {
            rows[k] = whole.row(mirrored(v + k - kernel.radius, height));
        }
        filter_down(rows, kernel, width, line);
        filter_across(line, kernel, 0, width, row);
        for (int u = 0; u < width; ++u) {
            by_rows[v * width + u] = row[u];
            by_pixels[v * width + u] = filtered_at(whole, kernel, u, v);
        }
    }
    *noise_gain = kernel.noise_gain;
}

int32_t stt_connect(int32_t *mask, int32_t width, int32_t height) {
    Arena arena = arena_of_tests();
    Connected spots(width, height, arena);
    const Plane<int32_t> plane{mask, width, height};
    auto *value = arena.take<float>(static_cast<size_t>(width));
    auto *limit = arena.take<float>(static_cast<size_t>(width));
    for (int v = 0; v < height; ++v) {
        for (int u = 0; u < width; ++u) {
            value[u] = static_cast<float>(plane.at(u, v));
            limit[u] = 0.0F;
        }
        spots.add_row(value, limit);
    }
    const int count = spots.number();
    for (int v = 0; v < height; ++v) {
        for (const Run &run : spots.row(v)) {
            for (int u = run.first; u <= run.last; ++u) {
                plane.at(u, v) = run.spot;
            }
        }
    }
    return count;
}

void stt_hits(const uint16_t *image, int32_t width, int32_t height, const double *places,
              int32_t count, double level_dn, double noise_dn, double sigma_px, double *hit) {
    const Image whole{image, width, height, width, 16};
    for (int i = 0; i < count; ++i) {
        Peak peak{};
        peak.u = static_cast<int>(places[2 * i]);
        peak.v = static_cast<int>(places[2 * i + 1]);
        peak.level = level_dn;
        hit[i] = is_hit(whole, peak, noise_dn, least_share(sigma_px)) ? 1.0 : 0.0;
    }
}

void stt_choose(const double *places, int32_t count, int32_t width, int32_t height, int32_t most,
                double cell_share, double *chosen) {
    Arena arena = arena_of_tests();
    const auto n = static_cast<size_t>(count);
    auto *place = arena.take<Place>(n);
    auto *good = arena.take<uint8_t>(n);
    for (int i = 0; i < count; ++i) {
        place[i] = {places[2 * i], places[2 * i + 1]};
    }
    choose(place, count, width, height, most, cell_share, good);
    for (int i = 0; i < count; ++i) {
        chosen[i] = good[i];
    }
}

void stt_exposure(double given_s, const double *shown, int32_t count, double exposure[3]) {
    Exposure estimated(given_s);
    for (int i = 0; i < count; ++i) {
        estimated.add(shown[2 * i], shown[2 * i + 1]);
    }
    const ExposureLimits limits = estimated.limits();
    exposure[0] = estimated.seconds();
    exposure[1] = limits.least_s;
    exposure[2] = limits.most_s;
}

}  // extern "C"
