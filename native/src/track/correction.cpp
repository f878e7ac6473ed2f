// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "track/correction.h"

#include <cmath>

#include "maths/sorting.h"
#include "maths/symmetric.h"
#include "track/innovation.h"

namespace st {

namespace {

/// What is known of the stars in the image for one correction (count each).
struct Sums {
    Flow *H;
    Innovation *innovation;
    double *weight;   // 0 for those that do not correct the attitude
    double *delay_s;  // of the most probable centroid
};

double square(double x) {
    return x * x;
}

/// List the stars that are predicted in the image.
void list_in_image(const Lens &lens, const FollowedStars &stars, const Matrix3 &R,
                   Correction &correction, Flow *H) {
    correction.count = 0;
    for (int n = 0; n < stars.count; ++n) {
        const Point plane = plane_point(lens.equidistant, sensor_direction(R, stars.icrf[n]));
        const Point uv = pixel_of(lens, plane);
        if (shows(lens, uv)) {
            correction.star[correction.count] = n;
            correction.predicted[correction.count] = uv;
            H[correction.count++] = image_flow(lens, plane);
        }
    }
}

/// Associate centroids with the stars in the image, each in the gate of its prediction:
/// S = H P H^T + R.
void associate_stars(const Matrix3 &P, const Flow *H, const Places &centroids,
                     const DetectionModel &detection, Correction &correction, Arena &memory,
                     Arena &work) {
    const Arena::Scope scope(work);
    auto *error = work.take<Covariance2>(static_cast<size_t>(correction.count));
    for (int k = 0; k < correction.count; ++k) {
        error[k] = pixel_covariance(H[k], P);
    }
    correction.association = association_for(correction.count, centroids.count, memory);
    associate({correction.count, correction.predicted, error}, centroids, detection,
              correction.association, work);
}

/// Return what the stars measure: of a rolling shutter turn and rate, by [H, d H].
Information measured_by(const Sums &sums, int count, bool rolling) {
    NormalEquations3 turn{}, cross{}, rate{};
    for (int k = 0; k < count; ++k) {
        turn.add(sums.H[k], sums.innovation[k], sums.weight[k]);
    }
    if (!rolling) {
        Information measured{3, {}, {}};
        set_block(measured.information, 0, 0, turn.information);
        for (int axis = 0; axis < 3; ++axis) {
            measured.vector[axis] = turn.vector[axis];
        }
        return measured;
    }
    for (int k = 0; k < count; ++k) {
        const double d = sums.delay_s[k];
        cross.add(sums.H[k], sums.innovation[k], sums.weight[k] * d);
        rate.add(sums.H[k], sums.innovation[k], sums.weight[k] * d * d);
    }
    return turn_and_rate(turn, cross, rate);
}

/// Fill the residuals of detected stars by the corrected state: of a residual r of covariance R,
/// normalised is sqrt(r^T R^-1 r), and distance_px as many sigma of the narrow axis of R.
void fill_residuals(const Lens &lens, const FollowedStars &stars, const Sums &sums,
                    const Vector3 &rate_change, const Places &centroids, Correction &correction) {
    const Matrix3 R_sensor = matrix_from_quaternion(correction.state.quaternion);
    for (int k = 0; k < correction.count; ++k) {
        if (correction.association.is_missed(k)) {
            continue;
        }
        Point uv = project(lens, sensor_direction(R_sensor, stars.icrf[correction.star[k]]));
        const Flow &H = sums.H[k];
        const double d = sums.delay_s[k];
        uv.x +=
            d * (H[0][0] * rate_change[0] + H[0][1] * rate_change[1] + H[0][2] * rate_change[2]);
        uv.y +=
            d * (H[1][0] * rate_change[0] + H[1][1] * rate_change[1] + H[1][2] * rate_change[2]);
        const Covariance2 &R = centroids.error[correction.best[k]];
        const double du = centroids.uv[correction.best[k]].x - uv.x;
        const double dv = centroids.uv[correction.best[k]].y - uv.y;
        const double normalised =
            std::sqrt((R.vv * du * du - 2 * R.uv * du * dv + R.uu * dv * dv) / determinant(R));
        // The corrected direction may be behind the camera.
        correction.normalised[k] = std::isfinite(normalised) ? normalised : INFINITY;
        const double half = (R.uu - R.vv) / 2;
        const double narrow = (R.uu + R.vv) / 2 - std::sqrt(half * half + R.uv * R.uv);
        correction.distance_px[k] = correction.normalised[k] * std::sqrt(narrow);
    }
}

/// Return the median of count values, which change their order; NaN for none.
double median_of(double *values, int count) {
    return count == 0 ? NAN : median(values, count);
}

/// Fill rms, chi-square and medians of the residuals of the inliers.
void summarise(const Places &centroids, Correction &correction, Arena &work) {
    const Arena::Scope scope(work);
    struct Inlier {
        double area2, normalised;
    };
    const auto size = static_cast<size_t>(correction.inliers);
    auto *inlier = work.take<Inlier>(size);
    auto *spare = work.take<Inlier>(size);
    auto *normalised = work.take<double>(size);
    int count = 0;
    double sum2 = 0.0;
    correction.chi2 = 0.0;
    for (int k = 0; k < correction.count; ++k) {
        if (correction.inlier[k]) {
            sum2 += square(correction.distance_px[k]);
            correction.chi2 += square(correction.normalised[k]);
            normalised[count] = correction.normalised[k];
            inlier[count++] = {determinant(centroids.error[correction.best[k]]),
                               correction.normalised[k]};
        }
    }
    correction.residual_px = std::sqrt(sum2 / count);
    correction.typical = median_of(normalised, count);
    // The half with the least errors has the weight in the fit: of 2 K residuals nearly all of its
    // three angles.
    const int half = count / 2;
    sort(inlier, count, spare, [](const Inlier &a, const Inlier &b) { return a.area2 < b.area2; });
    for (int k = 0; k < half; ++k) {
        normalised[k] = inlier[k].normalised;
    }
    const double left = half > 1 ? 1 - 1.5 / half : 0.1;
    correction.precise = median_of(normalised, half) / std::sqrt(left > 0.1 ? left : 0.1);
}

/// Return L^-1 v with S = L L^T, a vector of covariance S whitened; NaN where S is not a
/// covariance.
Vector3 whitened(const Matrix3 &S, const Vector3 &v) {
    Matrix3 L;
    if (!cholesky(S, L)) {
        return {{NAN, NAN, NAN}};
    }
    Vector3 x;
    for (int i = 0; i < 3; ++i) {
        x[i] = v[i];
        for (int k = 0; k < i; ++k) {
            x[i] -= L[i][k] * x[k];
        }
        x[i] /= L[i][i];
    }
    return x;
}

/// Fill turn, innovation and, of a rolling shutter, what an acceleration changes.
void fill_turn(const AttitudeState &predicted, const Sums &sums, Correction &correction) {
    const Information &measured = correction.measured;
    const bool rolling = measured.size > 3;
    correction.turn_covariance = inverse(measured.information);
    correction.turn = correction.turn_covariance * first<3>(measured.vector);
    Matrix3 S = block<3, 3>(predicted.covariance, 0, 0) + correction.turn_covariance;
    Matrix3 lever{};
    if (rolling) {
        // By an error e of the rate the turn is off by lever e.
        lever = correction.turn_covariance * block<3, 3>(measured.information, 0, 3);
        const Matrix3 cross = lever * block<3, 3>(predicted.covariance, 3, 0);
        S = S + cross + transposed(cross) +
            lever * block<3, 3>(predicted.covariance, 3, 3) * transposed(lever);
    }
    correction.innovation = whitened(S, correction.turn);
    if (!rolling) {
        return;
    }
    // An error e of the acceleration moves a star by J delay_s^2 / 2 e.
    Matrix<6, 3> moved;
    for (int power = 0; power < 2; ++power) {
        NormalEquations3 late{};
        for (int k = 0; k < correction.count; ++k) {
            const double d = sums.delay_s[k], d2 = d * d;
            late.add(sums.H[k], sums.innovation[k],
                     sums.weight[k] * (power == 0 ? d2 : d2 * d) / 2);
        }
        set_block(moved, 3 * power, 0, late.information);
    }
    double determinant = 0.0;
    correction.by_acceleration = solved_by_pivots(measured.information, moved, determinant);
    correction.turn =
        correction.turn - lever * (correction.state.rate_rad_s - predicted.rate_rad_s);
    correction.turn_covariance =
        correction.turn_covariance +
        lever * block<3, 3>(correction.state.covariance, 3, 3) * transposed(lever);
}

}  // namespace

size_t correction_bytes(int stars, int centroids) {
    const auto n = static_cast<size_t>(stars);
    return 2 * Arena::padded<int32_t>(n) + Arena::padded<Point>(n) + Arena::padded<bool>(n) +
           2 * Arena::padded<double>(n) + association_bytes(stars, centroids);
}

size_t correction_work_bytes(int stars, int centroids) {
    const auto n = static_cast<size_t>(stars);
    const size_t sums =
        Arena::padded<Flow>(n) + Arena::padded<Innovation>(n) + 2 * Arena::padded<double>(n);
    // summarise() needs less than the association did.
    return sums + Arena::padded<Covariance2>(n) + association_work_bytes(stars, centroids);
}

Correction correct(const Lens &lens, const FollowedStars &stars, const CorrectionLimits &limits,
                   const AttitudeState &predicted, const Places &centroids, const double *delay_s,
                   const DetectionModel &detection, Arena &memory, Arena &work) {
    const Arena::Scope scope(work);
    const auto most = static_cast<size_t>(stars.count);
    Correction correction{};
    correction.star = memory.take<int32_t>(most);
    correction.best = memory.take<int32_t>(most);
    correction.predicted = memory.take<Point>(most);
    correction.inlier = memory.take<bool>(most);
    correction.distance_px = memory.take<double>(most);
    correction.normalised = memory.take<double>(most);
    const Sums sums{work.take<Flow>(most), work.take<Innovation>(most), work.take<double>(most),
                    work.take<double>(most)};
    list_in_image(lens, stars, matrix_from_quaternion(predicted.quaternion), correction, sums.H);

    // Associate: the rows of a rolling shutter are also off by an error of the rate.
    double latest2 = 0.0;
    for (int j = 0; delay_s != nullptr && j < centroids.count; ++j) {
        latest2 = square(delay_s[j]) > latest2 ? square(delay_s[j]) : latest2;
    }
    const bool rolling = latest2 > 0;
    Matrix3 P = block<3, 3>(predicted.covariance, 0, 0);
    for (int i = 0; rolling && i < 3; ++i) {
        for (int k = 0; k < 3; ++k) {
            P[i][k] += latest2 * predicted.covariance[3 + i][3 + k];
        }
    }
    associate_stars(P, sums.H, centroids, detection, correction, memory, work);
    for (int k = 0; k < correction.count; ++k) {
        const Pairing *best = correction.association.best(k);
        const bool usable = stars.usable[correction.star[k]];
        const bool detected = best != nullptr && !correction.association.is_missed(k);
        correction.stars += usable ? 1 : 0;
        correction.best[k] = best == nullptr ? -1 : best->centroid;
        correction.distance_px[k] = correction.normalised[k] = INFINITY;
        // A star that was missed rather than not would pull towards the centroid of another one.
        sums.weight[k] = usable && detected ? 1 - correction.association.missed[k] : 0.0;
        sums.delay_s[k] = rolling && detected ? delay_s[best->centroid] : 0.0;
        sums.innovation[k] =
            combined_innovation(correction.predicted[k], centroids, correction.association, k);
    }

    // Correct, without one outlier more each time.
    for (;;) {
        correction.measured = measured_by(sums, correction.count, rolling);
        correction.state = with_measured(predicted, correction.measured);
        correction.inliers = 0;
        for (int k = 0; k < correction.count; ++k) {
            correction.inlier[k] = sums.weight[k] > 0;
            correction.inliers += correction.inlier[k] ? 1 : 0;
        }
        if (correction.inliers < limits.min_stars || correction.inliers == 0) {
            correction.residual_px = correction.chi2 = correction.typical = correction.precise =
                NAN;
            return correction;
        }
        fill_residuals(lens, stars, sums, correction.state.rate_rad_s - predicted.rate_rad_s,
                       centroids, correction);
        int worst = -1;
        for (int k = 0; k < correction.count; ++k) {
            if (correction.inlier[k] &&
                (worst < 0 || correction.normalised[k] > correction.normalised[worst])) {
                worst = k;
            }
        }
        if (correction.normalised[worst] <= limits.outlier_sigmas) {
            break;
        }
        sums.weight[worst] = 0.0;
    }
    correction.agreed = true;
    fill_turn(predicted, sums, correction);
    summarise(centroids, correction, work);
    return correction;
}

ImageMotion on_image(const Lens &lens, const Matrix3 &R, const Vector3 &icrf,
                     const AttitudeState &state) {
    const Point plane = plane_point(lens.equidistant, sensor_direction(R, icrf));
    const Point uv = pixel_of(lens, plane);
    const Flow J = image_flow(lens, plane);
    const Point velocity = velocity_of(J, state.rate_rad_s);
    ImageMotion star{{{uv.x, velocity.x, uv.y, velocity.y}}, {}};
    // Rows 2 k are J_k of the turn, rows 2 k + 1 J_k of the rate.
    for (int row = 0; row < 4; ++row) {
        Vector<6> half{};
        for (int k = 0; k < 6; ++k) {
            for (int j = 0; j < 3; ++j) {
                half[k] += J[row / 2][j] * state.covariance[3 * (row % 2) + j][k];
            }
        }
        for (int column = 0; column < 4; ++column) {
            for (int k = 0; k < 3; ++k) {
                star.covariance[row][column] += half[3 * (column % 2) + k] * J[column / 2][k];
            }
        }
    }
    return star;
}

}  // namespace st
