// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The stars of the sky file as a moving observer sees them: light deflection by the Sun, aberration
// and refraction; and which are blended with a planet, the Moon or the Sun.
//
// An attitude that is fitted to apparent directions is that of the sensor in ICRF, on GCRS axes.

#pragma once

#include <cstdint>

#include "maths/arena.h"
#include "sky/sky.h"

namespace st {

/// Observers that are kept, for identifications that come late.
constexpr int MOST_OBSERVERS = 64;

/// What star places are at: years after the epoch of the sky file, and how far the Earth has moved
/// about the barycentre since then.
struct Epoch {
    double years;
    Vector3 moved_au;
};

/// Return the unit vector that an observer measures of a natural one. An observer without aberration
/// measures the natural one.
Vector3 apparent_direction(const Vector3 &natural, const st_observer &observer);

/// Aberration of special relativity (ERFA, ab, without the potential of the Sun). natural is a unit
/// vector seen by an observer at rest; the opposite velocity is the inverse.
Vector3 aberrated(const Vector3 &natural, const Vector3 &velocity_m_s);

/// Light deflection by the Sun (ERFA, ldsun): 0.004 arcsec at a right angle from it.
Vector3 deflected(const Vector3 &natural, const Vector3 &heliocentric_au);

/// Refraction towards the zenith: z' = z - A tan z - B tan^3 z, with A and B for observed z, hence
/// corrected by one Newton step (ERFA, atioq).
Vector3 refracted(const Vector3 &direction, const Vector3 &zenith, double a_rad, double b_rad);

/// The sky of a tracker.
///
/// version changes when directions do; observer is that of the last look(), seen_by the one that the
/// directions are for: small changes of velocity are ignored.
struct ApparentSky {
    const SkyFile *file;
    const int32_t *by_hip;  // (stars), ascending
    Epoch epoch;
    uint64_t version;
    st_observer observer, seen_by;
    double least_cos[ST_MOST_BODIES];  // of the distance within which a body of observer blends
    int observers, newest;             // a ring
    struct {
        int64_t stamp_ns;
        st_observer observer;
    } given[MOST_OBSERVERS];
};

/// Return the bytes that start_sky() takes.
size_t apparent_sky_bytes(const SkyFile &file);

/// Start with an observer at rest.
void start_sky(const SkyFile &file, const Epoch &epoch, Arena &arena, ApparentSky &sky);

/// Forget the observers.
void forget_observers(ApparentSky &sky);

/// Use an observer from a time on.
void add_observer(int64_t stamp_ns, const st_observer &observer, ApparentSky &sky);

/// See the sky as the observer of a time: the newest one that is not later, else the first one. Where
/// it is older than its max_age_s the velocity is unknown, and there is no aberration.
void look(int64_t stamp_ns, ApparentSky &sky);

/// Return the direction of a star from the Earth, without aberration.
Vector3 natural_direction(const ApparentSky &sky, int32_t star);

/// Return the direction that is measured.
inline Vector3 apparent_direction(const ApparentSky &sky, int32_t star) {
    return apparent_direction(natural_direction(sky, star), sky.seen_by);
}

/// Whether a star is blended: with a neighbour, a planet, the Moon or the Sun.
bool is_crowded(const ApparentSky &sky, int32_t star);

/// Return the star of a catalogue number, -1 for none.
int32_t star_of_hip(const ApparentSky &sky, int32_t hip);

}  // namespace st
