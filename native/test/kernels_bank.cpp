// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "kernels_bank.h"

#include <algorithm>
#include <cmath>

#include "maths/numbers.h"
#include "sky/apparent.h"
#include "track/followed_stars.h"
#include "track/frame_motion.h"
#include "track/neighbourhood.h"
#include "track/new_stars.h"
#include "track/prediction.h"
#include "track/star_models.h"

using namespace st;

namespace {

/// Memory of the sky and of a model, and work memory; pages that none needs are never there.
alignas(ALIGNMENT) std::byte sky_memory[size_t{1} << 27], model_memory[size_t{1} << 24],
    work_memory[size_t{1} << 28];

struct {
    SkyFile file;
    ApparentSky sky;
    StarsInView view;
    Lens lens;
    StarModel model;
    IdentifiedFrame frame;
    Arena memory, model_memory;
} scene;

Arena work() {
    return {work_memory, sizeof(work_memory)};
}

/// Return work memory of just so many bytes: what does not fit is a null pointer.
Arena just(size_t bytes, Arena &arena) {
    return {arena.take<std::byte>(bytes), bytes};
}

Quaternion quaternion_of(const double q[4]) {
    return from<Quaternion>(q);
}

Places places(const double *uv, const double *error, int32_t count) {
    return {count, reinterpret_cast<const Point *>(uv),
            reinterpret_cast<const Covariance2 *>(error)};
}

/// Return what is not zero of a table (tracks, columns) whose first column is that of missed stars.
Association association_of(const double *table, int32_t tracks, int32_t columns, Arena &arena) {
    Association made = association_for(tracks, columns - 1, arena);
    for (int n = 0; n < tracks; ++n) {
        made.missed[n] = table[n * columns];
        for (int j = 1; j < columns; ++j) {
            if (table[n * columns + j] > 0) {
                made.pairing.add({j - 1, table[n * columns + j]});
            }
        }
        made.start[n + 1] = made.pairing.count;
    }
    return made;
}

void into_table(const Association &association, double *table) {
    const int columns = association.centroids + 1;
    std::fill_n(table, association.tracks * columns, 0.0);
    for (int n = 0; n < association.tracks; ++n) {
        table[n * columns] = association.missed[n];
        for (const Pairing *one = association.begin(n); one < association.end(n); ++one) {
            table[n * columns + 1 + one->centroid] = one->value;
        }
    }
}

MeasuredRoll roll_of(const double roll[3]) {
    return {roll[0] != 0, roll[1], roll[2]};
}

int32_t put(const List<StarInView> &seen, int32_t *star, double *sensor, double *uv) {
    for (int i = 0; i < seen.count; ++i) {
        star[i] = seen[i].star;
        into(sensor + 3 * i, seen[i].sensor);
        into(uv + 2 * i, seen[i].uv);
    }
    return seen.count;
}

void put_fit(const RotationFit &fit, double attitude[13], double figures[4], double *normalised) {
    into(attitude, fit.attitude.quaternion);
    into(attitude + 4, fit.attitude.covariance);
    figures[0] = fit.scale;
    figures[1] = fit.residual_px;
    figures[2] = fit.attitude.chi2;
    figures[3] = fit.attitude.stars;
    std::copy_n(fit.normalised, fit.count, normalised);
}

IdentifiedFrame frame_of(const st_hint &given, double scale) {
    IdentifiedFrame frame{};
    frame.stamp_ns = given.stamp_ns;
    frame.quaternion = quaternion_of(given.quaternion);
    frame.covariance = from<Matrix3>(given.covariance_rad2[0]);
    frame.scale = scale;
    return frame;
}

void put_start(const Start &start, double rates[21]) {
    into(rates, start.rate_rad_s);
    into(rates + 3, start.rate_covariance);
    into(rates + 12, start.cross);
}

}  // namespace

// --- association ---

double stt_marginalise(double *weight, int32_t tracks, int32_t columns, int32_t max_steps,
                       int32_t *left_out) {
    Arena arena = work();
    Association made = association_of(weight, tracks, columns, arena);
    Arena left = just(association_work_bytes(tracks, columns - 1), arena);
    const double log_sum = marginalise(made, max_steps, left);
    into_table(made, weight);
    left_out[0] = made.pairing.left_out;
    left_out[1] = made.states_left_out;
    return log_sum;
}

void stt_associate(const double *predicted, const double *covariance, int32_t tracks,
                   const double *uv, const double *error, int32_t centroids,
                   const double detection[4], int32_t factor, const int32_t *confirmed,
                   double *probability, int32_t *unassociated, int32_t *left_out) {
    Arena arena = work();
    Arena memory = just(association_bytes(tracks, centroids), arena);
    Arena left = just(factor < 0 ? association_work_bytes(tracks, centroids)
                                 : associate_stars_bytes(tracks, centroids),
                      arena);
    Association made = association_for(tracks, centroids, memory);
    const Places stars = places(predicted, covariance, tracks),
                 frame = places(uv, error, centroids);
    const auto model = from<DetectionModel>(detection);
    if (factor < 0) {
        associate(stars, frame, model, made, left);
    } else {
        associate_stars(stars, frame, model, static_cast<st_association>(factor), confirmed, made,
                        left);
    }
    if (probability != nullptr) {
        into_table(made, probability);
    }
    std::copy_n(made.unassociated, centroids, unassociated);
    left_out[0] = made.pairing.left_out;
    left_out[1] = made.states_left_out;
}

void stt_update(const double *probability, int32_t tracks, const double *uv,
                const double *variance, int32_t centroids, double *state, double *covariance) {
    Arena arena = work();
    const Association made = association_of(probability, tracks, centroids + 1, arena);
    for (int n = 0; n < tracks; ++n) {
        auto x = from<StarState>(state + 4 * n);
        auto P = from<StarCovariance>(covariance + 16 * n);
        update(made, n, reinterpret_cast<const Point *>(uv), variance, x, P);
        into(state + 4 * n, x);
        into(covariance + 16 * n, P);
    }
}

void stt_predict(const double transition[16], const double noise[16], int32_t tracks,
                 double *state, double *covariance) {
    for (int n = 0; n < tracks; ++n) {
        auto x = from<StarState>(state + 4 * n);
        auto P = from<StarCovariance>(covariance + 16 * n);
        predict(from<Matrix<4, 4>>(transition), from<Matrix<4, 4>>(noise), x, P);
        into(state + 4 * n, x);
        into(covariance + 16 * n, P);
    }
}

// --- motion ---

void stt_star_motion(int32_t model, double dt_s, double rate_rad_s, const double noise[2],
                     double transition[16], double covariance[16]) {
    const Point given = {noise[0], noise[1]};
    const StarMotion motion = model == ST_CONSTANT_VELOCITY
                                  ? constant_velocity(dt_s, given)
                                  : coordinated_turn(dt_s, rate_rad_s, given);
    into(transition, motion.transition);
    into(covariance, motion.noise);
}

void stt_rolled(const st_camera *camera, double rate_rad_s, double dt_s, double transition[16]) {
    into(transition, rolled(lens_of(*camera), rate_rad_s, dt_s));
}

void stt_turn_curvature(const st_camera *camera, const double *uv, int32_t count,
                        const double rate[3], double dt_s, double *curvature) {
    const Lens lens = lens_of(*camera);
    const auto w = from<Vector3>(rate);
    const Matrix3 turn = matrix_from_rotation_vector(scaled(w, dt_s));
    for (int n = 0; n < count; ++n) {
        into(curvature + 4 * n, turn_curvature(lens, from<Point>(uv + 2 * n), w, dt_s, turn));
    }
}

void stt_moved_by(const st_camera *camera, const double *uv, const double *variance, int32_t count,
                  const double rate[3], const double rate_covariance[9], double *state,
                  double *covariance) {
    const Lens lens = lens_of(*camera);
    for (int n = 0; n < count; ++n) {
        StarState x;
        StarCovariance P;
        moved_by(lens, from<Point>(uv + 2 * n), variance[n], from<Vector3>(rate),
                 from<Matrix3>(rate_covariance), x, P);
        into(state + 4 * n, x);
        into(covariance + 16 * n, P);
    }
}

void stt_propagated(const st_camera *camera, const double *uv, int32_t count, const double rate[3],
                    double dt_s, double *moved) {
    const Lens lens = lens_of(*camera);
    const Matrix3 turn = matrix_from_rotation_vector(scaled(from<Vector3>(rate), dt_s));
    for (int n = 0; n < count; ++n) {
        into(moved + 2 * n, propagated(lens, from<Point>(uv + 2 * n), turn));
    }
}

int32_t stt_body_rate(const st_camera *camera, const double *uv, const double *velocity,
                      const double *covariance, int32_t count, double rate[3],
                      double rate_covariance[9]) {
    const Lens lens = lens_of(*camera);
    NormalEquations3 sums{};
    for (int n = 0; n < count; ++n) {
        sums.add(flow_of(lens, unproject(lens, from<Point>(uv + 2 * n))),
                 {from<Point>(velocity + 2 * n), from<Covariance2>(covariance + 3 * n)}, 1.0);
    }
    Vector3 w{};
    Matrix3 P{};
    const bool is_fixed = body_rate(sums, w, P);
    into(rate, w);
    into(rate_covariance, P);
    return is_fixed ? 1 : 0;
}

int32_t stt_rate_between_frames(const st_camera *camera, const st_centroid *before,
                                int32_t before_count, const st_centroid *after,
                                int32_t after_count, double dt_s, double rate[3]) {
    Arena arena = work(), left = just(frame_motion_bytes(before_count, after_count), arena);
    Vector3 w{};
    const bool agree = rate_between_frames(lens_of(*camera), before, before_count, after,
                                           after_count, dt_s, w, left);
    into(rate, w);
    return agree ? 1 : 0;
}

void stt_star_neighbourhood(const st_camera *camera, const double *predicted, const double *icrf,
                            int32_t stars, const double *uv, const double *sigma_px,
                            int32_t centroids, int32_t *assigned) {
    Arena arena = work(), left = just(star_neighbourhood_bytes(stars, centroids), arena);
    const Lens lens = lens_of(*camera);
    star_neighbourhood(lens, 1 / std::sqrt(lens.fx * lens.fy),
                       reinterpret_cast<const Point *>(predicted),
                       reinterpret_cast<const Vector3 *>(icrf), stars,
                       reinterpret_cast<const Point *>(uv), sigma_px, centroids, assigned, left);
}

// --- sky ---

void stt_apparent(const st_observer *observer, const double *natural, int32_t count,
                  double *apparent) {
    for (int i = 0; i < count; ++i) {
        into(apparent + 3 * i, apparent_direction(from<Vector3>(natural + 3 * i), *observer));
    }
}

int32_t stt_open_view(const st_sky *file, const st_camera *camera, double years,
                      const double moved_au[3]) {
    scene.memory = {sky_memory, sizeof(sky_memory)};
    if (!open_sky(*file, scene.file, nullptr)) {
        return 0;
    }
    scene.lens = lens_of(*camera);
    start_sky(scene.file, {years, from<Vector3>(moved_au)}, scene.memory, scene.sky);
    start_view(scene.lens, stars_in_view_capacity(scene.file, scene.lens), scene.memory,
               scene.view);
    scene.frame = frame_for(4096, scene.memory);
    return 1;
}

void stt_add_observer(const int64_t *stamp_ns, const st_observer *observer) {
    add_observer(*stamp_ns, *observer, scene.sky);
}

int32_t stt_look(const int64_t *stamp_ns, double sigma[2]) {
    look(*stamp_ns, scene.sky);
    sigma[0] = scene.sky.observer.velocity_sigma_m_s;
    sigma[1] = scene.sky.observer.epoch_sigma_years;
    return static_cast<int32_t>(scene.sky.version);
}

void stt_sky_stars(const int32_t *star, int32_t count, double *direction, int32_t *crowded) {
    for (int i = 0; i < count; ++i) {
        into(direction + 3 * i, apparent_direction(scene.sky, star[i]));
        crowded[i] = is_crowded(scene.sky, star[i]) ? 1 : 0;
    }
}

int32_t stt_star_of_hip(int32_t hip) {
    return star_of_hip(scene.sky, hip);
}

int32_t stt_stars_in_view(const double q[4], int32_t capacity, int32_t *star, double *sensor,
                          double *uv) {
    Arena arena = work();
    auto seen = arena.list<StarInView>(static_cast<size_t>(capacity));
    stars_in_view(scene.sky, quaternion_of(q), scene.view, seen);
    return put(seen, star, sensor, uv);
}

int32_t stt_stars_beside(const double q[4], const double *pixel, int32_t count, double reach_px,
                         int32_t capacity, int32_t *star, double *sensor, double *uv) {
    Arena arena = work();
    auto seen = arena.list<StarInView>(static_cast<size_t>(capacity));
    stars_beside(scene.sky, quaternion_of(q), reinterpret_cast<const Point *>(pixel), count,
                 reach_px, scene.view, seen, arena);
    return put(seen, star, sensor, uv);
}

int32_t stt_unexplained(const double q[4], const st_centroid *centroids, int32_t count,
                        double reach_px, double reach_sigmas, int32_t *left) {
    Arena arena = work();
    return unexplained(scene.sky, quaternion_of(q), centroids, count, reach_px, reach_sigmas,
                       scene.view, left, arena);
}

int32_t stt_visible_stars(const double q[4], const double rate[3], double faintest,
                          int32_t capacity, double *visible) {
    List<ExpectedStar> stars{reinterpret_cast<ExpectedStar *>(visible), 0, capacity, 0};
    visible_stars(scene.sky, quaternion_of(q), from<Vector3>(rate), faintest, scene.view, stars);
    return stars.count;
}

int32_t stt_predict_stars(const double q[4], const double covariance[9], const double rate[3],
                          double faintest, int32_t capacity, st_prediction *predicted) {
    List<st_prediction> stars{predicted, 0, capacity, 0};
    predict_stars(scene.sky, quaternion_of(q), from<Matrix3>(covariance), from<Vector3>(rate),
                  faintest, scene.view, stars);
    return stars.count;
}

int32_t stt_new_stars(const double q[4], const double covariance[9], const double *free,
                      int32_t count, double zero_point, double magnitude_tolerance,
                      int32_t capacity, int32_t *found) {
    Arena arena = work();
    auto *centroids = arena.take<FreeCentroid>(static_cast<size_t>(count));
    for (int j = 0; j < count; ++j) {
        const double *one = free + 4 * j;
        centroids[j] = {j, {one[0], one[1]}, one[2], one[3]};
    }
    List<NewStar> stars{reinterpret_cast<NewStar *>(found), 0, capacity, 0};
    match_new_stars(scene.sky, quaternion_of(q), from<Matrix3>(covariance), scene.lens, centroids,
                    count, zero_point, magnitude_tolerance, scene.view, stars, arena);
    return stars.count;
}

// --- fits and starts ---

int32_t stt_fit_rotation(const st_camera *camera, const double *icrf, const double *uv,
                         const double *sigma_px, const int32_t *candidate, int32_t count,
                         int32_t solver, double attitude[13], double figures[4],
                         double *normalised, int32_t *inlier) {
    Arena arena = work();
    auto *chosen = arena.take<bool>(static_cast<size_t>(count));
    for (int i = 0; i < count; ++i) {
        chosen[i] = candidate[i] != 0;
    }
    Arena memory = just(rotation_fit_bytes(count), arena);
    Arena left = just(rotation_fit_work_bytes(count), arena);
    RotationFit fit = rotation_fit_for(count, memory);
    if (!fit_rotation(lens_of(*camera), reinterpret_cast<const Vector3 *>(icrf),
                      reinterpret_cast<const Point *>(uv), sigma_px, chosen,
                      static_cast<st_solver>(solver), fit, left)) {
        return 0;
    }
    put_fit(fit, attitude, figures, normalised);
    std::copy_n(fit.inlier, count, inlier);
    return 1;
}

int32_t stt_fit_identified(const st_tracking_options *options, const st_centroid *centroids,
                           const int32_t *hip, int32_t count, int32_t *star, st_centroid *centroid,
                           double attitude[13], double *scale, st_reason *reason) {
    Arena arena = work(), left = just(fit_identified_bytes(count), arena);
    if (!fit_identified(scene.lens, scene.sky, *options, 0, centroids, hip, count, scene.frame,
                        *reason, left)) {
        return 0;
    }
    const IdentifiedFrame &frame = scene.frame;
    std::copy_n(frame.star.item, frame.star.count, star);
    std::copy_n(frame.centroid.item, frame.star.count, centroid);
    into(attitude, frame.quaternion);
    into(attitude + 4, frame.covariance);
    *scale = frame.scale;
    return frame.star.count;
}

int32_t stt_contradicts(const double q[4], const double covariance[9], double max_residual_px) {
    return contradicts(scene.frame, quaternion_of(q), from<Matrix3>(covariance), scene.lens,
                       scene.sky, max_residual_px)
               ? 1
               : 0;
}

void stt_start_of_two(const st_hint *first, double first_scale, const st_hint *second,
                      double second_scale, double rates[21]) {
    const IdentifiedFrame before = frame_of(*first, first_scale);
    const IdentifiedFrame after = frame_of(*second, second_scale);
    put_start(start_of_two(before, after), rates);
}

int32_t stt_start_of_hint(const st_hint *hint, const st_hint *frame, double scale,
                          double max_gap_s, int32_t hinted, double rates[21]) {
    const IdentifiedFrame seen = frame_of(*frame, scale);
    Start start;
    HintedStart hints{};
    if (hinted != 0) {
        add_hint(*hint, hints);
    }
    if (!(hinted != 0 ? start_of_hint(hints, seen, max_gap_s, start)
                      : start_of_prediction(*hint, seen, start))) {
        return 0;
    }
    put_start(start, rates);
    return 1;
}

// --- models of stars ---

void stt_open_model(const st_tracking_options *options, const st_hint *start,
                    const double roll[3]) {
    scene.model_memory = {model_memory, sizeof(model_memory)};
    make_star_model(*options, scene.lens, scene.model_memory, scene.model);
    const IdentifiedFrame frame = frame_of(*start, 1.0);
    const Start given = {
        &frame, from<Vector3>(start->rate_rad_s), from<Matrix3>(start->rate_covariance[0]), {}, {},
        false};
    start_stars(given, roll_of(roll), scene.model);
}

int32_t stt_add_star(const st_tracking_options *options, int32_t star, const st_centroid *centroid,
                     int32_t confirmed) {
    return add_star(0, star, *centroid, confirmed != 0, *options, scene.model) ? 1 : 0;
}

void stt_select_tracks(const int32_t *kept, const int32_t *confirmed) {
    Arena arena = work();
    const int count = scene.model.bank.count;
    auto *mask = arena.take<bool>(static_cast<size_t>(count));
    for (int n = 0; n < count; ++n) {
        mask[n] = kept[n] != 0;
        scene.model.bank[n].confirmed = confirmed[n] != 0;
    }
    select(scene.model.bank, mask);
}

void stt_update_model(const st_tracking_options *options, const int64_t *stamp_ns,
                      const st_centroid *centroids, int32_t count, const double roll[3],
                      double *track, double attitude[13], double figures[4], double rates[12],
                      double *normalised, double *uv, int32_t *unassociated, int32_t flags[5]) {
    Arena arena = work();
    StarModel &model = scene.model;
    StarUpdate updated;
    Arena memory = just(star_update_bytes(*options, count), arena);
    Arena left = just(star_update_work_bytes(*options, count), arena);
    update_stars(*stamp_ns, centroids, count, roll_of(roll), scene.sky, *options, model, updated,
                 memory, left);
    for (int n = 0; n < model.bank.count; ++n) {
        const Track &one = model.bank[n];
        double *row = track + 30 * n;
        into(row, one.state);
        into(row + 4, one.covariance);
        const double rest[10] = {one.variance,
                                 one.flux_dn,
                                 one.snr,
                                 one.sigma_px,
                                 one.residual_px,
                                 one.probability,
                                 static_cast<double>(one.star),
                                 static_cast<double>(one.age),
                                 static_cast<double>(one.missed),
                                 one.confirmed ? 1.0 : 0.0};
        std::copy_n(rest, 10, row + 20);
    }
    if (updated.has_fit) {
        put_fit(updated.fit, attitude, figures, normalised);
    }
    into(rates, model.rate_rad_s);
    into(rates + 3, model.rate_covariance);
    for (int j = 0; j < count; ++j) {
        into(uv + 2 * j, updated.uv[j]);
        unassociated[j] = updated.unassociated[j] ? 1 : 0;
    }
    flags[0] = updated.good ? 1 : 0;
    flags[1] = updated.has_fit ? 1 : 0;
    flags[2] = model.uses_gyro ? 1 : 0;
    flags[3] = model.gyro_trouble.code;
    flags[4] = model.bank.count;
}

int32_t stt_publish(int32_t identified, int32_t capacity, st_star_track *tracks) {
    return publish(scene.model.bank, scene.file, identified != 0, tracks, capacity);
}

void stt_zero_point(double *magnitude) {
    Arena arena = work();
    *magnitude = zero_point(scene.model.bank, scene.file, arena);
}

void stt_keep(const int32_t *crowded, double most_missed, int32_t confirm_frames, int32_t *kept,
              int32_t *confirmed) {
    for (int n = 0; n < scene.model.bank.count; ++n) {
        Track track = scene.model.bank[n];
        kept[n] = is_kept(track, crowded[n] != 0, most_missed) ? 1 : 0;
        confirm(track, confirm_frames);
        confirmed[n] = track.confirmed ? 1 : 0;
    }
}

int32_t stt_detected_stars(const double q[4], const double rate[3], const double *icrf,
                           const double *distance, const int32_t *best, const double *uv,
                           const double *error, int32_t centroids, double *detected) {
    Arena arena = work();
    const TrackList &bank = scene.model.bank;
    auto stars = arena.list<DetectedStar>(static_cast<size_t>(bank.count));
    detected_stars(scene.lens, quaternion_of(q), from<Vector3>(rate), bank,
                   reinterpret_cast<const Vector3 *>(icrf), distance, best,
                   places(uv, error, centroids), stars);
    for (int i = 0; i < stars.count; ++i) {
        double *row = detected + 16 * i;
        row[0] = stars[i].track;
        into(row + 1, stars[i].uv);
        into(row + 3, stars[i].residual);
        into(row + 5, stars[i].error);
        into(row + 8, stars[i].flow);
        into(row + 14, stars[i].velocity);
    }
    return stars.count;
}
