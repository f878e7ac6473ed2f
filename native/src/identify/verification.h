// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Verification of a candidate attitude by all stars of the field.
//
// A candidate assigns catalogue stars to a few image stars. The attitude and the focal length that
// fit them associate the other image stars with the catalogue (association.h). The false-alarm
// probability is that of so good an agreement by chance (false_alarm.h). A lens that differs from
// its model is found by its near misses (lens_mismatch.h).

#pragma once

#include "identify/association.h"
#include "identify/patterns.h"

namespace st {

/// Fields at which the density of the sky is sampled at most, and those that have a star at most.
constexpr int MOST_SAMPLES = 2000, SAMPLES_OF_STAR = 100;

/// The part of the sky that an image shows: borders of the undistorted coordinates on its axes, the
/// chord from the optical axis to the farthest corner, area in rad^2 at the scale of the middle,
/// and the solid angle.
struct Field {
    double low_a, high_a, low_b, high_b, chord;
    double area, solid_angle;
};

/// Return the field of a lens: that of its image circle where it has one.
Field field_of(const Lens &lens);

/// What verifies candidates of one camera and one sky.
struct Verifier {
    Patterns sky;
    Field field;
    bool equidistant;
    // The stars of a candidate were chosen by their brightness, which is then no evidence for them.
    bool bases_by_brightness;
    // False for a lens that is fitted after the identification: its near misses are expected.
    bool lens_known;
    double tolerance_sigmas, side_sigmas;  // of stars, of sides of triangles
    double scale_error;                    // of the focal length, a share
    int samples;
    int32_t counts[MOST_SAMPLES];  // stars in fields about random directions, ascending
};

/// Set the numbers of stars in fields about random directions.
void count_fields(Verifier &verifier);

/// Return how many of so many brightest stars are in the field about an attitude.
int count_in_image(const Verifier &verifier, const StarMatch &found, int32_t brightest);

/// The result: 1 is a rejected candidate.
struct Verification {
    double false_alarm;
    StarMatch found;
};

/// Return memory for the verification of so many image stars.
Verification verification(int most, Arena &arena);

/// Copy what belongs to count image stars.
void copy(const Verification &from, int count, Verification &to);

/// Verify that the image stars base are the catalogue stars star, both of some length; tested is
/// the number of candidates so far.
void verify(const Verifier &verifier, const ImageStars &stars, const int32_t *base,
            const int32_t *star, int based, double tested, Verification &result, Arena &work);

/// Whether two matches of count image stars share two stars, which excludes two attitudes.
bool same_attitude(const StarMatch &a, const StarMatch &b, int count);

/// Bytes of work memory that verify() and fit_attitude() take for so many image stars.
size_t verification_bytes(int most);

}  // namespace st
