// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "identify/identification_stage.h"

#include <algorithm>
#include <cmath>

#include "attitude/results.h"

namespace st {
namespace {

// Of the very brightest stars: few pairs, all of them in the processor's cache.
constexpr BrightLevel BRIGHT{4, 3};

constexpr int32_t NOT_COUNTED = -1;

st_reason reason_of(st_reason_code code, double a, double b, double c = 0.0) {
    return {code, 0, {a, b, c}};
}

int32_t as_count(double number) {
    return static_cast<int32_t>(std::fmin(number, INT32_MAX));
}

}  // namespace

IdentificationSetup setup_of(const st_config &config, const SkyFile &sky, int most_centroids) {
    const st_identification_options &options = config.identification;
    return {patterns_of(sky),        BRIGHT,        options.fov_error_percent / 100, false, true,
            options.max_image_stars, most_centroids};
}

IdentificationStage::IdentificationStage(const st_identification_options &options,
                                         const st_camera &camera, const IdentificationSetup &setup,
                                         Arena &kept)
    : options_(options),
      lens_(lens_of(camera)),
      bright_(setup.bright),
      most_stars_(setup.most_stars),
      most_centroids_(setup.most_centroids) {
    verifier_.sky = setup.sky;
    verifier_.field = field_of(lens_);
    verifier_.equidistant = lens_.equidistant;
    verifier_.bases_by_brightness = setup.bases_by_brightness;
    verifier_.lens_known = setup.lens_known;
    verifier_.tolerance_sigmas = options.tolerance_sigmas;
    verifier_.side_sigmas = SIDE_SIGMAS * options.tolerance_sigmas;
    verifier_.scale_error = setup.scale_error;
    verifier_.counts[0] = NOT_COUNTED;
    if (has_pairs()) {
        count_fields(verifier_);
        search_ = StarSearch(most_stars_, setup.sky, kept);
    }
}

const Verifier &IdentificationStage::verifier() {
    if (verifier_.counts[0] == NOT_COUNTED) {
        count_fields(verifier_);
    }
    return verifier_;
}

size_t IdentificationStage::bytes(const IdentificationSetup &setup) {
    return setup.sky.pairs.star != nullptr ? StarSearch::bytes(setup.most_stars, setup.sky) : 0;
}

size_t IdentificationStage::work_bytes(const IdentificationSetup &setup) {
    const auto most = static_cast<size_t>(setup.most_stars);
    const auto centroids = static_cast<size_t>(setup.most_centroids);
    // Image stars and a verification for calls of tools on the ground.
    return 2 * Arena::padded<int32_t>(centroids) + verification_bytes(setup.most_stars) +
           2 * Arena::padded<int32_t>(most) + Arena::padded<Vector3>(most) +
           Arena::padded<Point>(most) + 4 * Arena::padded<double>(most);
}

void IdentificationStage::begin(int64_t stamp_ns, const st_centroid *centroids, int count,
                                double shear_px, Arena &work) {
    stamp_ns_ = stamp_ns;
    centroids_ = count;
    brightest_stars(lens_, centroids, count, options_.max_image_stars,
                    std::hypot(options_.sigma_floor_px, shear_px), search_.stars(), work);
    search_.begin(options_.most_work_s);
    searching_ = true;
}

void IdentificationStage::proceed(double slice_s, const volatile uint32_t *stop,
                                  st_identification &result, List<st_identified> &identified,
                                  Arena &work) {
    identified.clear();
    const Outcome outcome =
        search_.proceed(verifier_, bright_, options_.false_alarm_max, slice_s, stop, work);
    const bool stopped = outcome == Outcome::SEARCHING && stop != nullptr && *stop != 0;
    searching_ = outcome == Outcome::SEARCHING && !stopped;
    const double tested = search_.tested();
    const int stars = search_.stars().count;
    result = waiting();
    switch (outcome) {
        case Outcome::IDENTIFIED:
            publish(result, identified, work);
            break;
        case Outcome::TOO_FEW:
            result.status = ST_TOO_FEW_STARS;
            result.reason = reason_of(ST_REASON_TOO_FEW_USABLE, stars, LEAST_STARS);
            break;
        case Outcome::AMBIGUOUS:
            result.status = ST_AMBIGUOUS;
            result.reason =
                reason_of(ST_REASON_AMBIGUOUS, count_matched(search_.best().found, stars),
                          search_.other_matched());
            break;
        case Outcome::EXHAUSTED:
            result.status = ST_NO_CANDIDATE;
            result.reason =
                reason_of(ST_REASON_NO_CANDIDATE, stars, tested,
                          verifier_.sky.stars * verifier_.field.solid_angle / (4 * M_PI));
            break;
        case Outcome::MOST_WORK:
            result.status = ST_TIME_LIMIT;
            result.reason = reason_of(ST_REASON_MOST_WORK, options_.most_work_s, tested);
            break;
        case Outcome::SEARCHING:
            if (stopped) {
                result.status = ST_TIME_LIMIT;
                result.reason = reason_of(ST_REASON_STOPPED, tested, 0.0);
            }
            break;
    }
}

st_identification IdentificationStage::waiting() const {
    st_identification result{};
    set_unknown(result.attitude);
    result.attitude.stamp_ns = stamp_ns_;
    result.status = ST_SEARCHING;
    result.focal_ratio = 1.0;
    result.false_alarm_probability = search_.best().false_alarm;
    result.work_s = search_.work_s();
    result.candidates = as_count(search_.tested());
    return result;
}

void IdentificationStage::publish(st_identification &result, List<st_identified> &identified,
                                  Arena &work) const {
    const Arena::Scope scope(work);
    const ImageStars &stars = this->stars();
    const StarMatch &found = this->found();
    auto *angle_rad = work.take<double>(static_cast<size_t>(stars.count));
    const double pixels = std::sqrt(lens_.fx * lens_.fy);
    const AttitudeFit best =
        fit_attitude(verifier_.sky, lens_.equidistant, stars, found, angle_rad, work);
    set_fit(best, angle_rad, stars.count, 1 / pixels, result.attitude);
    result.status = ST_IDENTIFIED;
    result.stars = result.attitude.stars;
    result.focal_ratio = found.focal_ratio;
    result.reason = reason_of(ST_REASON_IDENTIFIED, result.stars, 0.0);
    for (int i = 0; i < centroids_; ++i) {
        identified.add({NAN, NAN, NAN, 0, 0});
    }
    for (int i = 0; i < stars.count; ++i) {
        const int32_t star = found.star[i];
        if (star >= 0) {
            identified[stars.index[i]] = {verifier_.sky.magnitude[star],
                                          found.residual[i] * pixels, angle_rad[i],
                                          verifier_.sky.hip[star], 0};
        }
    }
}

void set_fit(const AttitudeFit &fit, const double *angle_rad, int count, double pixel_rad,
             st_attitude &attitude) {
    double square = 0.0;
    for (int i = 0; i < count; ++i) {
        if (angle_rad[i] >= 0) {
            ++attitude.stars;
            square += angle_rad[i] * angle_rad[i];
        }
    }
    const Quaternion &q = fit.q;
    const double quaternion[4] = {q.x, q.y, q.z, q.w};
    std::copy(quaternion, quaternion + 4, attitude.quaternion);
    for (int i = 0; i < 3; ++i) {
        std::copy(fit.P[i], fit.P[i] + 3, attitude.covariance_rad2[i]);
    }
    attitude.chi2 = fit.chi2;
    attitude.residual_px = std::sqrt(square / attitude.stars) / pixel_rad;
    attitude.valid = 1;
}

}  // namespace st
