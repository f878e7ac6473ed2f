// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Every check that decides whether a frame is used and an attitude is trusted: its figures.
//
// Code that evaluates a check takes its threshold from here. docs/integrity.md has the evidence and
// the action of each, out of startracker_ros/core/integrity/checks.py, which reads the figures
// through st_checks(): they stand here alone.

#pragma once

#include <cmath>
#include <initializer_list>

#include "reason.h"
#include "startracker.h"
#include "startracker_ground.h"

namespace st {

/// A chi-square of dof degrees of freedom that is exceeded with a probability: gate(), which is
/// compared with the threshold by a test.
struct Chance {
    double probability;
    int dof;
    double threshold;
};

/// Where there is no chi-square: a probability of its own, or none.
constexpr Chance likelihood(double probability) {
    return {probability, 0, 0.0};
}

constexpr Chance NO_CHANCE{0.0, 0, 0.0};

/// Return a check; frames are those that it looks at, 0 for one.
constexpr st_check check(const char *name, st_reason_code reason, const Chance &chance,
                         int frames = 0, std::initializer_list<st_limit> limits = {}) {
    st_check made{name, chance.probability, chance.threshold, chance.dof, frames, reason, 0, {}};
    for (const st_limit &limit : limits) {
        made.limit[made.limits++] = limit;
    }
    return made;
}

constexpr bool same_text(const char *a, const char *b) {
    while (*a != '\0' && *a == *b) {
        ++a;
        ++b;
    }
    return *a == *b;
}

#ifdef __cpp_consteval
#define ST_CONSTEVAL consteval
#else
#define ST_CONSTEVAL constexpr  // of compilers before 2021
#endif

/// Return a limit of a check by its name; what reads past the last one does not compile.
ST_CONSTEVAL double limit(const st_check &check, const char *name) {
    int k = 0;
    while (!same_text(check.limit[k].name, name)) {
        ++k;
    }
    return check.limit[k].value;
}

/// Return the square root of the threshold.
inline double sigmas(const st_check &check) {
    return std::sqrt(check.threshold);
}

/// Return the reason of a check with its figures.
inline st_reason reason_of(const st_check &check, std::initializer_list<double> figures) {
    return reason_of(check.reason, figures);
}

namespace checks {

// --- frames, as they come ---
inline constexpr st_check LATE_FRAME =
    check("LATE_FRAME", ST_REASON_NOT_NEWER, NO_CHANCE, 0, {{"back_s", 1.0}});
inline constexpr st_check TIME_JUMP = check("TIME_JUMP", ST_REASON_TIME_BACK, NO_CHANCE);
inline constexpr st_check REPEATED_FRAME =
    check("REPEATED_FRAME", ST_REASON_REPEATED_CENTROIDS, NO_CHANCE, 0, {{"moved_px", 0.02}});
inline constexpr st_check UNUSABLE_CENTROID = check("UNUSABLE_CENTROID", ST_NO_REASON, NO_CHANCE);

// --- the start ---
inline constexpr st_check MISFIT = check("MISFIT", ST_REASON_MISFIT, NO_CHANCE);
inline constexpr st_check SECOND_TOO_LATE =
    check("SECOND_TOO_LATE", ST_REASON_NO_SECOND, NO_CHANCE);
inline constexpr st_check START_RATE = check("START_RATE", ST_REASON_TOO_FAST, NO_CHANCE);
inline constexpr st_check HINT =
    check("HINT", ST_NO_REASON, NO_CHANCE, 0, {{"sigma_deg", 2.0}, {"rate_sigma_deg_s", 0.5}});
inline constexpr st_check HINT_DIFFERS =
    check("HINT_DIFFERS", ST_NO_REASON, {1e-5, 3, 25.901749745662052});
inline constexpr st_check HINT_FAILED = check("HINT_FAILED", ST_NO_REASON, NO_CHANCE, 5);
// 10 sigma: beyond errors of the lens, below wrong stars by far.
inline constexpr st_check IDENTIFICATION_DIFFERS =
    check("IDENTIFICATION_DIFFERS", ST_REASON_CHECK_CONTRADICTS,
          {1.55415943139e-21, 3, 99.99999999999949}, 0, {{"residual_ratio", 3.0}});

// --- the filter ---
inline constexpr st_check STAR_OUTLIER =  // 5 sigma
    check("STAR_OUTLIER", ST_NO_REASON, {3.72665317208e-6, 2, 24.999999999999286});
inline constexpr st_check LIKELY_INNOVATION =
    check("LIKELY_INNOVATION", ST_NO_REASON, {0.05, 3, 7.81472790325118});
inline constexpr st_check INNOVATION =
    check("INNOVATION", ST_NO_REASON, {1e-5, 3, 25.901749745662052});
inline constexpr st_check FEW_AGREE =
    check("FEW_AGREE", ST_NO_REASON, NO_CHANCE, 0, {{"stars_for_one", 3}});
inline constexpr st_check BAD_FRAMES = check("BAD_FRAMES", ST_REASON_BAD_FRAMES, NO_CHANCE);
inline constexpr st_check STARS_ELSEWHERE =
    check("STARS_ELSEWHERE", ST_REASON_STARS_ELSEWHERE, NO_CHANCE, 2);
inline constexpr st_check NO_STARS = check("NO_STARS", ST_REASON_NO_STARS, NO_CHANCE);
inline constexpr st_check DIVERGED =  // 20 sigma
    check("DIVERGED", ST_REASON_DIVERGED, {2.2138865931e-86, 3, 400.00000000000097}, 5);
inline constexpr st_check FILTER_COVARIANCE =
    check("FILTER_COVARIANCE", ST_REASON_NOT_POSITIVE, NO_CHANCE);
inline constexpr st_check SHEARED_STARS =
    check("SHEARED_STARS", ST_NO_REASON, NO_CHANCE, 0, {{"stars", 3}});
inline constexpr st_check FAST_TURN = check("FAST_TURN", ST_NO_REASON, NO_CHANCE, 0,
                                            {{"width_share", 0.02}, {"neighbourhood_px", 10.0}});

// --- a gyro ---
inline constexpr st_check GYRO_SILENT =
    check("GYRO_SILENT", ST_NO_REASON, NO_CHANCE, 0, {{"age_s", 1.0}});
inline constexpr st_check GYRO_AT_RANGE =
    check("GYRO_AT_RANGE", ST_REASON_GYRO_AT_RANGE, NO_CHANCE);
// Twice: the light of one frame may be that of a body that was kicked.
inline constexpr st_check GYRO_DIFFERS =
    check("GYRO_DIFFERS", ST_REASON_GYRO_DISAGREES, {1e-5, 3, 25.901749745662052}, 2);
inline constexpr st_check GYRO_BLIND =
    check("GYRO_BLIND", ST_REASON_GYRO_AT_RANGE_BLIND, NO_CHANCE);
inline constexpr st_check MOTION_ENDS = check("MOTION_ENDS", ST_NO_REASON, likelihood(1e-3));

// --- errors that the stars show or do not exclude, in the error budget ---
inline constexpr st_check JUMP_IN_FRAME = check("JUMP_IN_FRAME", ST_NO_REASON, likelihood(0.02));
// No body jumps and goes on as before, but images of another time do.
inline constexpr st_check DISPLACED =
    check("DISPLACED", ST_NO_REASON, {0.05, 3, 7.81472790325118}, 4);
inline constexpr st_check STAMP_ERRORS = check("STAMP_ERRORS", ST_NO_REASON, NO_CHANCE, 10,
                                               {{"products", 3},
                                                {"many", 2.5},
                                                {"few", 15.0},
                                                {"expected", 2.0},
                                                {"shaken", 2.0},
                                                {"first_s", 5e-3}});
inline constexpr st_check LENS_ERROR =  // 4 sigma
    check("LENS_ERROR", ST_NO_REASON, {6.33424836662e-5, 1, 16.00000000000119}, 0, {{"stars", 6}});
inline constexpr st_check ERROR_SCALE = check("ERROR_SCALE", ST_NO_REASON, NO_CHANCE, 20,
                                              {{"large", 1.15}, {"small", 0.9}, {"least", 0.5}});

// --- one attitude in all of an image ---
inline constexpr st_check TORN_FRAME =  // 6 sigma
    check("TORN_FRAME", ST_REASON_ROWS_LATE, {1.973175290075e-9, 1, 36.00000000000039}, 0,
          {{"stars", 8}, {"explained_share", 0.5}, {"step_px", 0.1}});
inline constexpr st_check LINE_TIME =  // chi-square of 20
    check("LINE_TIME", ST_REASON_LINE_TIME, {7.74421643104e-6, 1, 20.00000000000101}, 0,
          {{"explained_share", 0.2}, {"slope_px", 0.05}});
inline constexpr st_check FIRST_LINE_TIME =  // 3 sigma
    check("FIRST_LINE_TIME", ST_REASON_LINE_TIME, {2.69979606326e-3, 1, 9.000000000000126}, 5);
inline constexpr st_check SECOND_IMAGE =
    check("SECOND_IMAGE", ST_REASON_SECOND_IMAGE, NO_CHANCE, 0,
          {{"stars", 4}, {"share", 0.2}, {"reach_px", 80.0}, {"present_px", 0.5}});
inline constexpr st_check MISSING_STARS = check("MISSING_STARS", ST_REASON_STARS_ABSENT, NO_CHANCE,
                                                0, {{"missed_share", 0.4}, {"placed_share", 0.7}});

// --- what is published ---
inline constexpr st_check FEW_STARS = check("FEW_STARS", ST_REASON_TOO_FEW_STARS, NO_CHANCE);
inline constexpr st_check STAR_RESIDUALS = check("STAR_RESIDUALS", ST_REASON_RESIDUAL, NO_CHANCE);
inline constexpr st_check TRACK_RESIDUALS =
    check("TRACK_RESIDUALS", ST_REASON_TRACKS_ASIDE, NO_CHANCE);
// Always scaled, covariances of few stars would be too large on average.
inline constexpr st_check LARGE_CHI2 = check("LARGE_CHI2", ST_NO_REASON, likelihood(1e-3));
inline constexpr st_check COVARIANCE = check("COVARIANCE", ST_REASON_ERRORS_UNKNOWN, NO_CHANCE);
// Each rejected star says that there may be others.
inline constexpr st_check PROTECTION = check("PROTECTION", ST_NO_REASON, likelihood(1e-4));

// --- several heads ---
inline constexpr st_check HEAD_DIFFERS =
    check("HEAD_DIFFERS", ST_NO_REASON, {1e-6, 3, 30.664849706213598});
// 3 sigma: chance is only later for it, a larger error would be let in.
inline constexpr st_check HEAD_RETURNS =
    check("HEAD_RETURNS", ST_NO_REASON, {0.0292908865349, 3, 8.999999999999115});

}  // namespace checks
}  // namespace st
