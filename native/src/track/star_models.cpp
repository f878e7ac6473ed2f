// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "track/star_models.h"

#include <algorithm>
#include <cmath>

#include "attitude/pointing.h"
#include "track/neighbourhood.h"
#include "track/rolling_shutter.h"

namespace st {
namespace {

constexpr double DEG = M_PI / 180;

/// The attitude by TRIAD is that of two tracks.
constexpr double TRIAD_STARS = 2.0;

double sigma_of(const st_centroid &centroid, const st_tracking_options &options) {
    return std::fmax(centroid.sigma_px, options.sigma_floor_px);
}

/// Centroids of a frame at its time: places, and errors per axis.
struct Measured {
    const st_centroid *centroid;
    int count;
    Point *uv;
    double *sigma_px, *variance;
    Covariance2 *error;
};

Measured measured(const st_centroid *centroids, int count, const st_tracking_options &options,
                  const StarModel &model, Arena &memory, Arena &work) {
    const auto m = static_cast<size_t>(count);
    const Measured frame{centroids,
                         count,
                         memory.take<Point>(m),
                         work.take<double>(m),
                         work.take<double>(m),
                         work.take<Covariance2>(m)};
    for (int j = 0; j < count; ++j) {
        const st_centroid &one = centroids[j];
        frame.uv[j] = {one.u_px, one.v_px};
        if (one.delay_s != 0) {
            frame.uv[j] =
                at_frame_time(model.lens, frame.uv[j], one.delay_s, model.rate_rad_s, {});
        }
        frame.sigma_px[j] = sigma_of(one, options);
        frame.variance[j] = frame.sigma_px[j] * frame.sigma_px[j];
        frame.error[j] = round_error(frame.variance[j]);
    }
    return frame;
}

// --- prediction ---

/// Return the sum of the information of the confirmed tracks about the common motion, 1/px^2.
///
/// An acceleration of the camera moves all stars alike and does not average out over them as centroid
/// errors do: with the same process noise for each star as for all the covariance of the attitude of
/// all tracks would be too small. The noise of a track is multiplied by the variance of its star over
/// that of the mean of all stars, N if they are equally good. Then each track has the gain of one
/// filter of the common motion, and the attitude of all tracks the covariance of that filter.
double information_of(const TrackList &bank) {
    double information = 0.0;
    for (const Track &track : bank) {
        information += track.confirmed ? 1 / track.variance : 0.0;
    }
    return information;
}

/// Return the process noise of a star at x, y from the principal point by a roll of the camera, and
/// that of the gyro: position and velocity by an acceleration constant within the step.
Matrix<4, 4> roll_noise(const Lens &lens, double x, double y, double dt_s,
                        double acceleration_rad_s2, double gyro_noise_density) {
    const double velocity = acceleration_rad_s2 * dt_s, position = velocity * dt_s / 2;
    const double roll[2][2] = {
        {position * position + gyro_noise_density * dt_s, position * velocity},
        {velocity * position, velocity * velocity}};
    const double along[2] = {y * lens.fx / lens.fy, -x * lens.fy / lens.fx};
    Matrix<4, 4> noise;
    for (int a = 0; a < 2; ++a) {
        for (int b = 0; b < 2; ++b) {
            for (int i = 0; i < 2; ++i) {
                for (int j = 0; j < 2; ++j) {
                    noise[2 * a + i][2 * b + j] = along[a] * along[b] * roll[i][j];
                }
            }
        }
    }
    return noise;
}

/// Return the roll rates that the velocities contain and will contain; zero where none is measured:
/// then the roll is part of the motion that the model predicts.
struct Rolls {
    double before, after;
};

Rolls take_roll(const MeasuredRoll &roll, const st_tracking_options &options, StarModel &model) {
    const MeasuredRoll before = model.roll;
    model.roll = roll;
    model.uses_gyro = roll.is_there;
    model.gyro_trouble = reason_of(
        roll.is_there || options.roll_by_gyro == 0 ? ST_NO_REASON : ST_REASON_NO_ROLL, {});
    if (!roll.is_there) {
        return {0.0, 0.0};
    }
    return {before.is_there ? before.rate_rad_s : roll.rate_rad_s, roll.rate_rad_s};
}

/// Predict the tracks by their own velocities.
void predict_filters(double dt_s, const Rolls &rolls, const st_tracking_options &options,
                     StarModel &model) {
    const Lens &lens = model.lens;
    const bool is_turn = model.kind == ST_COORDINATED_TURN;
    const double acceleration = options.acceleration_deg_s2 * DEG;
    const Point acceleration_px = {acceleration * lens.fx, acceleration * lens.fy};
    Vector3 rate = model.rate_rad_s;
    rate[2] -= rolls.before;
    // The image turns against the body. Density for the same change of velocity per step.
    const double root = std::sqrt(dt_s);
    StarMotion motion =
        is_turn ? coordinated_turn(dt_s, -rate[2],
                                   {acceleration_px.x * root, acceleration_px.y * root})
                : constant_velocity(dt_s, acceleration_px);
    if (model.uses_gyro) {
        motion.transition =
            rolled(lens, rolls.after, dt_s) * motion.transition * rolled(lens, -rolls.before, 0.0);
    }
    const double information = information_of(model.bank);
    const double most = options.solver == ST_TRIAD ? TRIAD_STARS : INFINITY;
    const Matrix3 turn = matrix_from_rotation_vector(scaled(rate, dt_s));
    for (Track &track : model.bank) {
        const double x = track.state[0] - lens.cx, y = track.state[2] - lens.cy;
        const double factor = std::fmin(std::fmax(track.variance * information, 1.0), most);
        Matrix<4, 4> noise =
            motion.noise + roll_noise(lens, x, y, dt_s, options.roll_acceleration_deg_s2 * DEG,
                                      model.uses_gyro ? model.roll.noise_density : 0.0);
        for (auto &row : noise.row) {
            for (double &element : row) {
                element *= factor;
            }
        }
        const StarState curvature =
            is_turn ? StarState{} : turn_curvature(lens, track.uv(), rate, dt_s, turn);
        track.state[0] = x;
        track.state[2] = y;
        predict(motion.transition, noise, track.state, track.covariance);
        track.state[0] += lens.cx;
        track.state[2] += lens.cy;
        for (int i = 0; i < 4; ++i) {
            track.state[i] += curvature[i];
        }
    }
    model.rate_rad_s = rate;
    model.rate_rad_s[2] += rolls.after;
}

/// Predict the tracks by the body rate alone.
void propagate(double dt_s, StarModel &model) {
    const Matrix3 turn = matrix_from_rotation_vector(scaled(model.rate_rad_s, dt_s));
    for (Track &track : model.bank) {
        const Point uv = propagated(model.lens, track.uv(), turn);
        track.state[0] = uv.x;
        track.state[2] = uv.y;
        for (int a = 0; a < 4; a += 2) {
            for (int b = 0; b < 4; b += 2) {
                track.covariance[a][b] += dt_s * dt_s * track.covariance[a + 1][b + 1];
            }
        }
    }
}

// --- update ---

struct Predicted {
    Places places;
    Vector3 *icrf;
};

Predicted predicted_places(const StarModel &model, const ApparentSky &sky, Arena &work) {
    const TrackList &bank = model.bank;
    const auto n = static_cast<size_t>(bank.count);
    auto *uv = work.take<Point>(n);
    auto *error = work.take<Covariance2>(n);
    auto *icrf = work.take<Vector3>(n);
    for (int i = 0; i < bank.count; ++i) {
        uv[i] = bank[i].uv();
        error[i] = bank[i].uv_covariance();
        icrf[i] = apparent_direction(sky, bank[i].star);
    }
    return {{bank.count, uv, error}, icrf};
}

/// Update the filters by all centroids.
Association associate_filters(const Measured &frame, const Predicted &stars,
                              const st_tracking_options &options, StarModel &model, Arena &memory,
                              Arena &work) {
    TrackList &bank = model.bank;
    int32_t *confirmed = nullptr;
    if (options.sna_confirmation != 0) {
        confirmed = work.take<int32_t>(static_cast<size_t>(bank.count));
        star_neighbourhood(model.lens, pixel_angle(model.lens), stars.places.uv, stars.icrf,
                           bank.count, frame.uv, frame.sigma_px, frame.count, confirmed, work);
    }
    Association association = association_for(bank.count, frame.count, memory);
    associate_stars(stars.places, {frame.count, frame.uv, frame.error}, model.detection,
                    static_cast<st_association>(options.association), confirmed, association,
                    work);
    for (int n = 0; n < bank.count; ++n) {
        update(association, n, frame.uv, frame.variance, bank[n].state, bank[n].covariance);
    }
    return association;
}

/// Set each star to the centroid of the star neighbourhood approach.
Association associate_neighbours(const Measured &frame, const Predicted &stars, StarModel &model,
                                 Arena &memory, Arena &work) {
    TrackList &bank = model.bank;
    auto *assigned = work.take<int32_t>(static_cast<size_t>(bank.count));
    star_neighbourhood(model.lens, pixel_angle(model.lens), stars.places.uv, stars.icrf,
                       bank.count, frame.uv, frame.sigma_px, frame.count, assigned, work);
    Association association = association_for(bank.count, frame.count, memory);
    for (int n = 0; n < bank.count; ++n) {
        const int32_t j = assigned[n];
        if (j >= 0) {
            association.pairing.add({j, 1.0});
            association.missed[n] = 0.0;
            association.unassociated[j] = false;
            StarCovariance &P = bank[n].covariance;
            bank[n].state[0] = frame.uv[j].x;
            bank[n].state[2] = frame.uv[j].y;
            P[0][0] = P[2][2] = frame.variance[j];
            P[0][2] = P[2][0] = 0.0;
        }
        association.start[n + 1] = association.pairing.count;
    }
    return association;
}

bool fit(const Predicted &stars, const st_tracking_options &options, const StarModel &model,
         RotationFit &found, Arena &work) {
    const TrackList &bank = model.bank;
    const auto n = static_cast<size_t>(bank.count);
    auto *uv = work.take<Point>(n);
    auto *sigma_px = work.take<double>(n);
    auto *detected = work.take<bool>(n);
    for (int i = 0; i < bank.count; ++i) {
        uv[i] = bank[i].uv();
        sigma_px[i] = bank[i].uv_sigma_px();
        detected[i] = bank[i].is_detected();
    }
    return fit_rotation(model.lens, stars.icrf, uv, sigma_px, detected,
                        static_cast<st_solver>(options.solver), found, work);
}

/// Set the body rate to that of the velocities of the stars that agree.
void rate_by_velocities(const RotationFit &fit, StarModel &model) {
    NormalEquations3 sums{};
    for (int n = 0; n < model.bank.count; ++n) {
        const Track &track = model.bank[n];
        if (track.is_detected() && fit.normalised[n] <= outlier_sigmas()) {
            const StarCovariance &P = track.covariance;
            sums.add(flow_of(model.lens, unproject(model.lens, track.uv())),
                     {{track.state[1], track.state[3]}, {P[1][1], P[1][3], P[3][3]}}, 1.0);
        }
    }
    body_rate(sums, model.rate_rad_s, model.rate_covariance);
}

/// Set the body rate to that between two attitudes, and the velocities to those by it.
void rate_by_attitudes(const RotationFit &fit, StarModel &model) {
    const double dt_s = static_cast<double>(model.stamp_ns - model.fitted_ns) * 1e-9;
    const Vector3 turn = attitude_error(fit.attitude.quaternion, model.fitted);
    for (int i = 0; i < 3; ++i) {
        model.rate_rad_s[i] = turn[i] / dt_s;
        for (int j = 0; j < 3; ++j) {
            model.rate_covariance[i][j] =
                (model.fitted_covariance[i][j] + fit.attitude.covariance[i][j]) / (dt_s * dt_s);
        }
    }
    model.fitted_ns = model.stamp_ns;
    model.fitted = fit.attitude.quaternion;
    model.fitted_covariance = fit.attitude.covariance;
    for (Track &track : model.bank) {
        const Flow J = flow_of(model.lens, unproject(model.lens, track.uv()));
        const Point velocity = velocity_of(J, model.rate_rad_s);
        const Covariance2 moved = pixel_covariance(J, model.rate_covariance);
        track.state[1] = velocity.x;
        track.state[3] = velocity.y;
        track.covariance[1][1] = moved.uu;
        track.covariance[1][3] = track.covariance[3][1] = moved.uv;
        track.covariance[3][3] = moved.vv;
    }
}

}  // namespace

size_t star_model_bytes(const st_tracking_options &options) {
    return Arena::padded<Track>(static_cast<size_t>(options.max_stars));
}

size_t star_update_bytes(const st_tracking_options &options, int centroids) {
    return Arena::padded<Point>(static_cast<size_t>(centroids)) +
           association_bytes(options.max_stars, centroids) + rotation_fit_bytes(options.max_stars);
}

size_t star_update_work_bytes(const st_tracking_options &options, int centroids) {
    const int stars = options.max_stars;
    const auto n = static_cast<size_t>(stars), m = static_cast<size_t>(centroids);
    const size_t frame = 2 * Arena::padded<double>(m) + Arena::padded<Covariance2>(m);
    const size_t places = Arena::padded<Point>(n) + Arena::padded<Covariance2>(n) +
                          Arena::padded<Vector3>(n) + Arena::padded<int32_t>(n);
    const size_t fits = Arena::padded<Point>(n) + Arena::padded<double>(n) +
                        Arena::padded<bool>(n) + rotation_fit_work_bytes(stars);
    return frame + places +
           std::max({star_neighbourhood_bytes(stars, centroids),
                     associate_stars_bytes(stars, centroids), fits});
}

void make_star_model(const st_tracking_options &options, const Lens &lens, Arena &arena,
                     StarModel &model) {
    model = {};
    model.kind = static_cast<st_motion_model>(options.model);
    model.lens = lens;
    model.detection = detection_model(options, lens);
    model.bank = arena.list<Track>(static_cast<size_t>(options.max_stars));
}

void start_stars(const Start &start, const MeasuredRoll &roll, StarModel &model) {
    model.bank.clear();
    model.stamp_ns = model.fitted_ns = start.frame->stamp_ns;
    model.fitted = start.frame->quaternion;
    model.fitted_covariance = start.frame->covariance;
    model.rate_rad_s = start.rate_rad_s;
    model.rate_covariance = start.rate_covariance;
    model.roll = roll;
    model.uses_gyro = false;
    model.gyro_trouble = reason_of(ST_NO_REASON, {});
}

bool add_star(uint32_t track_id, int32_t star, const st_centroid &centroid, bool confirmed,
              const st_tracking_options &options, StarModel &model) {
    const double sigma_px = sigma_of(centroid, options);
    Track track = started_track(track_id, star, centroid, sigma_px * sigma_px, confirmed);
    moved_by(model.lens, track.uv(), track.variance, model.rate_rad_s, model.rate_covariance,
             track.state, track.covariance);
    return model.bank.add(track);
}

void predict_tracks(int64_t stamp_ns, const MeasuredRoll &roll, const st_tracking_options &options,
                    StarModel &model, Arena &work) {
    const double dt_s = static_cast<double>(stamp_ns - model.stamp_ns) * 1e-9;
    if (model.kind == ST_SNA) {
        propagate(dt_s, model);
    } else {
        predict_filters(dt_s, take_roll(roll, options, model), options, model);
    }
    model.stamp_ns = stamp_ns;
    const Arena::Scope scope(work);
    auto *inside = work.take<bool>(static_cast<size_t>(model.bank.count));
    for (int n = 0; n < model.bank.count; ++n) {
        inside[n] = shows(model.lens, model.bank[n].uv());
    }
    select(model.bank, inside);
}

void update_stars(int64_t stamp_ns, const st_centroid *centroids, int count,
                  const MeasuredRoll &roll, const ApparentSky &sky,
                  const st_tracking_options &options, StarModel &model, StarUpdate &updated,
                  Arena &memory, Arena &work) {
    const Arena::Scope scope(work);
    const Measured frame = measured(centroids, count, options, model, memory, work);
    predict_tracks(stamp_ns, roll, options, model, work);
    const Predicted stars = predicted_places(model, sky, work);
    const Association association =
        model.kind == ST_SNA ? associate_neighbours(frame, stars, model, memory, work)
                             : associate_filters(frame, stars, options, model, memory, work);
    int confirmed = 0;
    for (int n = 0; n < model.bank.count; ++n) {
        // One place for each track. NOLINTNEXTLINE(clang-analyzer-core.NonNullParamChecker)
        follow(model.bank[n], association, n, stars.places.uv[n], frame.uv, centroids,
               frame.variance);
        confirmed += model.bank[n].confirmed ? 1 : 0;
    }
    updated = {};
    updated.uv = frame.uv;
    updated.unassociated = association.unassociated;
    updated.pairings_left_out = association.pairing.left_out;
    updated.states_left_out = association.states_left_out;
    updated.fit = rotation_fit_for(model.bank.count, memory);
    updated.has_fit = fit(stars, options, model, updated.fit, work);
    updated.good =
        updated.has_fit && is_good(updated.fit.attitude.stars, confirmed, updated.fit.residual_px,
                                   options.min_stars, options.max_residual_px);
    if (!updated.good) {
        if (model.uses_gyro && count >= options.min_stars) {
            model.gyro_trouble = reason_of(ST_REASON_ROLL_DISAGREES, {});
        }
        return;
    }
    if (model.kind == ST_SNA) {
        rate_by_attitudes(updated.fit, model);
    } else {
        rate_by_velocities(updated.fit, model);
    }
    updated.fit.attitude.covariance =
        updated.fit.attitude.covariance +
        pointing_covariance(model.lens, correlated_error(centroids, count), nullptr);
}

}  // namespace st
