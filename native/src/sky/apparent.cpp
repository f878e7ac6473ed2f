// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "sky/apparent.h"

#include <algorithm>
#include <cmath>

namespace st {
namespace {

constexpr double SPEED_OF_LIGHT_M_S = 299792458.0;
constexpr double SUN_SCHWARZSCHILD_AU = 1.97412574336e-8;  // 2 G M / c^2 (ERFA, erfam.h)

/// Cosine of the zenith distance below which refraction no longer grows: 6 deg of elevation.
constexpr double LOWEST_COS = 0.1;

/// Change of velocity that is ignored: 0.001 arcsec of aberration.
constexpr double TOLERANCE_M_S = 1.5;

/// 1 sigma per axis where the velocity of the Earth, 29.8 km/s, and that of a low orbit about it,
/// 7.9 km/s, are unknown.
constexpr double UNKNOWN_SIGMA_M_S = 17799.34455722083;

/// Largest magnitude difference of a blended neighbour: with a tenth of the light it shifts the
/// centroid by a tenth of the overlap.
constexpr double CROWD_MAGNITUDES = 2.5;

Vector3 vector_of(const double *numbers) {
    return {{numbers[0], numbers[1], numbers[2]}};
}

st_observer at_rest() {
    st_observer observer{};
    observer.aberration = ST_ABERRATION_NONE;
    for (double &coordinate : observer.heliocentric_au) {
        coordinate = NAN;
    }
    observer.max_age_s = INFINITY;
    return observer;
}

bool is_at_rest(const st_observer &observer) {
    return observer.aberration == ST_ABERRATION_NONE;
}

/// Whether the directions of two observers are the same.
bool see_alike(const st_observer &one, const st_observer &other) {
    if (is_at_rest(one) || is_at_rest(other)) {
        return is_at_rest(one) == is_at_rest(other);
    }
    double square = 0.0;
    for (int i = 0; i < 3; ++i) {
        const double change = other.velocity_m_s[i] - one.velocity_m_s[i];
        square += change * change;
    }
    return square < TOLERANCE_M_S * TOLERANCE_M_S;
}

void use(const st_observer &observer, ApparentSky &sky) {
    sky.observer = observer;
    if (!see_alike(sky.seen_by, observer)) {
        sky.seen_by = observer;
        ++sky.version;
    }
    for (int k = 0; k < observer.body_count; ++k) {
        const st_body &body = observer.body[k];
        const double reach_rad = body.radius_rad + body.error_rad + sky.file->crowd_rad;
        sky.least_cos[k] = std::cos(std::fmin(reach_rad, M_PI));
    }
}

}  // namespace

Vector3 aberrated(const Vector3 &natural, const Vector3 &velocity_m_s) {
    Vector3 beta;
    for (int i = 0; i < 3; ++i) {
        beta[i] = velocity_m_s[i] / SPEED_OF_LIGHT_M_S;
    }
    const double inverse_gamma = std::sqrt(1 - dot(beta, beta));
    const double along = 1 + dot(natural, beta) / (1 + inverse_gamma);
    Vector3 apparent;
    for (int i = 0; i < 3; ++i) {
        apparent[i] = natural[i] * inverse_gamma + along * beta[i];
    }
    const double length = norm(apparent);
    for (int i = 0; i < 3; ++i) {
        apparent[i] /= length;
    }
    return apparent;
}

Vector3 deflected(const Vector3 &natural, const Vector3 &heliocentric_au) {
    const double distance_au = norm(heliocentric_au);
    Vector3 from_sun, sum;
    for (int i = 0; i < 3; ++i) {
        from_sun[i] = heliocentric_au[i] / distance_au;
        sum[i] = natural[i] + from_sun[i];
    }
    // Behind the Sun the deflection is limited, as its light is not seen there.
    const double least = 1e-6 / std::fmax(distance_au * distance_au, 1.0);
    const double w = SUN_SCHWARZSCHILD_AU / distance_au / std::fmax(dot(natural, sum), least);
    const Vector3 away = cross(natural, cross(from_sun, natural));
    Vector3 apparent;
    for (int i = 0; i < 3; ++i) {
        apparent[i] = natural[i] + w * away[i];
    }
    return apparent;
}

Vector3 refracted(const Vector3 &direction, const Vector3 &zenith, double a_rad, double b_rad) {
    const double cosine = dot(direction, zenith), z = std::fmax(cosine, LOWEST_COS);
    Vector3 across;
    for (int i = 0; i < 3; ++i) {
        across[i] = direction[i] - cosine * zenith[i];
    }
    const double r = norm(across), tangent = r / z;
    const double w = b_rad * tangent * tangent;
    const double change = (a_rad + w) * tangent / (1 + (a_rad + 3 * w) / (z * z));
    const double least = std::fmax(r, 1e-12), cos_change = std::cos(change),
                 sin_change = std::sin(change);
    Vector3 raised;
    for (int i = 0; i < 3; ++i) {
        raised[i] = cos_change * direction[i] +
                    sin_change * (r * zenith[i] - cosine * (across[i] / least));
    }
    const double length = norm(raised);
    for (int i = 0; i < 3; ++i) {
        raised[i] /= length;
    }
    return raised;
}

Vector3 apparent_direction(const Vector3 &natural, const st_observer &observer) {
    if (is_at_rest(observer)) {
        return natural;
    }
    Vector3 direction = natural;
    // NaN where it is not known.
    if (std::isfinite(observer.heliocentric_au[0])) {
        direction = deflected(direction, vector_of(observer.heliocentric_au));
    }
    direction = aberrated(direction, vector_of(observer.velocity_m_s));
    if (observer.refraction_a_rad != 0 || observer.refraction_b_rad != 0) {
        direction = refracted(direction, vector_of(observer.zenith), observer.refraction_a_rad,
                              observer.refraction_b_rad);
    }
    return direction;
}

size_t apparent_sky_bytes(const SkyFile &file) {
    return Arena::padded<int32_t>(static_cast<size_t>(file.stars));
}

void start_sky(const SkyFile &file, const Epoch &epoch, Arena &arena, ApparentSky &sky) {
    auto *by_hip = arena.take<int32_t>(static_cast<size_t>(file.stars));
    for (int32_t star = 0; star < file.stars; ++star) {
        by_hip[star] = star;
    }
    const auto before = [&](int32_t a, int32_t b) { return file.hip[a] < file.hip[b]; };
    std::make_heap(by_hip, by_hip + file.stars, before);
    std::sort_heap(by_hip, by_hip + file.stars, before);
    sky.file = &file;
    sky.by_hip = by_hip;
    sky.epoch = epoch;
    sky.version = 1;
    sky.seen_by = at_rest();
    forget_observers(sky);
}

void forget_observers(ApparentSky &sky) {
    sky.observers = sky.newest = 0;
    use(at_rest(), sky);
}

void add_observer(int64_t stamp_ns, const st_observer &observer, ApparentSky &sky) {
    sky.newest = sky.observers == 0 ? 0 : (sky.newest + 1) % MOST_OBSERVERS;
    sky.observers = std::min(sky.observers + 1, MOST_OBSERVERS);
    sky.given[sky.newest] = {stamp_ns, observer};
}

void look(int64_t stamp_ns, ApparentSky &sky) {
    if (sky.observers == 0) {
        return;
    }
    int found = sky.newest;
    for (int back = 1; back < sky.observers && sky.given[found].stamp_ns > stamp_ns; ++back) {
        found = (sky.newest + MOST_OBSERVERS - back) % MOST_OBSERVERS;
    }
    st_observer observer = sky.given[found].observer;
    const double age_s = static_cast<double>(stamp_ns - sky.given[found].stamp_ns) * 1e-9;
    if (!is_at_rest(observer) && !(age_s <= observer.max_age_s)) {
        observer.aberration = ST_ABERRATION_NONE;
        observer.velocity_sigma_m_s = UNKNOWN_SIGMA_M_S;
    }
    use(observer, sky);
}

Vector3 natural_direction(const ApparentSky &sky, int32_t star) {
    const Vector3 &moved_au = sky.epoch.moved_au;
    if (sky.epoch.years == 0 && moved_au[0] == 0 && moved_au[1] == 0 && moved_au[2] == 0) {
        return vector_of(sky.file->direction[star]);
    }
    return direction_at(*sky.file, star, sky.epoch.years, moved_au);
}

bool is_crowded(const ApparentSky &sky, int32_t star) {
    if (sky.file->crowded[star] != 0) {
        return true;
    }
    if (sky.observer.body_count == 0) {
        return false;
    }
    const Vector3 direction = natural_direction(sky, star);
    for (int k = 0; k < sky.observer.body_count; ++k) {
        const st_body &body = sky.observer.body[k];
        // One that is much fainter than the star does not count.
        if (dot(direction, vector_of(body.direction)) >= sky.least_cos[k] &&
            !(sky.file->magnitude[star] < body.magnitude - CROWD_MAGNITUDES)) {
            return true;
        }
    }
    return false;
}

int32_t star_of_hip(const ApparentSky &sky, int32_t hip) {
    const int32_t *end = sky.by_hip + sky.file->stars;
    const int32_t *found = std::lower_bound(
        sky.by_hip, end, hip, [&](int32_t star, int32_t of) { return sky.file->hip[star] < of; });
    return found < end && sky.file->hip[*found] == hip ? *found : -1;
}

}  // namespace st
