// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "track/in_view.h"

#include <algorithm>
#include <cmath>

namespace st {
namespace {

constexpr double DEG = M_PI / 180;

/// Margin around the image of the cached stars, so that most frames need no catalogue search.
constexpr double AHEAD_RAD = 0.5 * DEG;

/// No apparent direction is so far from the one in the catalogue: refraction has 0.6 deg.
constexpr double APPARENT_RAD = 1.0 * DEG;

/// Density of the stars of the densest fields over the mean, and stars for small fields.
constexpr double DENSEST = 4.0;
constexpr int LEAST_CAPACITY = 512;

/// Return the cosine of the angle within which stars may be seen within reach_px.
double cos_reach(const StarsInView &view, double reach_px) {
    return std::cos(std::fmin(APPARENT_RAD + 2 * reach_px * view.pixel_rad, M_PI));
}

/// Mark which near stars have one of pixels uv (count) near.
template <class PixelOf>
void mark_beside(const Matrix3 &R, const StarsInView &view, PixelOf pixel_of, int count,
                 double least_cos, bool *is_beside) {
    std::fill_n(is_beside, view.near.count, false);
    for (int i = 0; i < count; ++i) {
        const Point uv = pixel_of(i);
        if (!(std::isfinite(uv.x) && std::isfinite(uv.y))) {
            continue;
        }
        const Vector3 d = R * unproject(view.lens, uv);
        for (int k = 0; k < view.near.count; ++k) {
            is_beside[k] = is_beside[k] || dot(view.natural[k], d) >= least_cos;
        }
    }
}

}  // namespace

int stars_in_view_capacity(const SkyFile &file, const Lens &lens) {
    const double radius = std::fmin(corner_angle(lens) + AHEAD_RAD, M_PI);
    const double share = (1 - std::cos(radius)) / 2;
    return static_cast<int>(
        std::fmin(file.stars, std::ceil(DENSEST * share * file.stars) + LEAST_CAPACITY));
}

size_t stars_in_view_bytes(int capacity) {
    const auto n = static_cast<size_t>(capacity);
    return Arena::padded<int32_t>(n) + 2 * Arena::padded<Vector3>(n);
}

void start_view(const Lens &lens, int capacity, Arena &arena, StarsInView &view) {
    const auto n = static_cast<size_t>(capacity);
    view.lens = lens;
    view.corner_rad = corner_angle(lens);
    view.pixel_rad = 1 / std::sqrt(lens.fx * lens.fy);
    view.cos_corner = std::cos(view.corner_rad);
    view.cos_ahead = std::cos(AHEAD_RAD);
    view.centre = {};
    view.near = arena.list<int32_t>(n);
    view.natural = arena.take<Vector3>(n);
    view.direction = arena.take<Vector3>(n);
    view.version = 0;
    view.computed = 0;
}

Matrix3 turn_view(const ApparentSky &sky, const Quaternion &attitude, StarsInView &view) {
    const Matrix3 R = matrix_from_quaternion(attitude);
    const Vector3 boresight = {{R[0][2], R[1][2], R[2][2]}};
    if (!(dot(boresight, view.centre) > view.cos_ahead)) {
        view.centre = boresight;
        const int found = stars_in_cone(*sky.file, boresight, view.corner_rad + AHEAD_RAD,
                                        view.near.item, view.near.capacity);
        view.near.count = std::min(found, view.near.capacity);
        view.near.left_out = found - view.near.count;
        for (int i = 0; i < view.near.count; ++i) {
            view.natural[i] = natural_direction(sky, view.near[i]);
        }
        view.computed = 0;
    }
    return R;
}

const Vector3 &direction_in_view(const ApparentSky &sky, int i, StarsInView &view) {
    if (view.version != sky.version) {
        view.version = sky.version;
        view.computed = 0;
    }
    for (; view.computed <= i; ++view.computed) {
        view.direction[view.computed] =
            apparent_direction(view.natural[view.computed], sky.seen_by);
    }
    return view.direction[i];
}

int brighter_in_view(const SkyFile &file, double faintest, const StarsInView &view) {
    const int32_t *found =
        std::upper_bound(view.near.begin(), view.near.end(), faintest,
                         [&](double limit, int32_t star) { return limit < file.magnitude[star]; });
    return static_cast<int>(found - view.near.begin());
}

bool see(const ApparentSky &sky, const Matrix3 &attitude, int i, StarsInView &view,
         StarInView &seen) {
    seen.star = view.near[i];
    seen.sensor = sensor_direction(attitude, direction_in_view(sky, i, view));
    if (!(seen.sensor[2] >= view.cos_corner)) {
        return false;
    }
    seen.uv = project(view.lens, seen.sensor);
    return true;
}

void stars_in_view(const ApparentSky &sky, const Quaternion &attitude, StarsInView &view,
                   List<StarInView> &seen) {
    const Matrix3 R = turn_view(sky, attitude, view);
    StarInView star;
    for (int i = 0; i < view.near.count; ++i) {
        if (see(sky, R, i, view, star)) {
            seen.add(star);
        }
    }
}

void stars_beside(const ApparentSky &sky, const Quaternion &attitude, const Point *uv, int count,
                  double reach_px, StarsInView &view, List<StarInView> &seen, Arena &work) {
    const Matrix3 R = turn_view(sky, attitude, view);
    const Arena::Scope scope(work);
    auto *is_beside = work.take<bool>(static_cast<size_t>(view.near.count));
    mark_beside(
        R, view, [&](int i) { return uv[i]; }, count, cos_reach(view, reach_px), is_beside);
    StarInView star;
    for (int i = 0; i < view.near.count; ++i) {
        if (is_beside[i] && see(sky, R, i, view, star)) {
            seen.add(star);
        }
    }
}

namespace {

/// Keep those of the centroids left (count) that have none of stars uv (stars) near.
int still_unexplained(const st_centroid *centroids, const Point *uv, int stars, double reach_px,
                      double reach_sigmas, int32_t *left, int count) {
    int kept = 0;
    for (int k = 0; k < count; ++k) {
        const st_centroid &one = centroids[left[k]];
        bool is_free = one.sigma_px > 0 && std::isfinite(one.u_px) && std::isfinite(one.v_px);
        const double reach = std::fmax(reach_px, reach_sigmas * one.sigma_px);
        for (int i = 0; i < stars && is_free; ++i) {
            const double du = one.u_px - uv[i].x, dv = one.v_px - uv[i].y;
            is_free = du * du + dv * dv > reach * reach;
        }
        if (is_free) {
            left[kept++] = left[k];
        }
    }
    return kept;
}

}  // namespace

int unexplained(const ApparentSky &sky, const Quaternion &attitude, const st_centroid *centroids,
                int count, double reach_px, double reach_sigmas, StarsInView &view, int32_t *left,
                Arena &work) {
    const Matrix3 R = turn_view(sky, attitude, view);
    const Arena::Scope scope(work);
    const auto near = static_cast<size_t>(view.near.count);
    auto *uv = work.take<Point>(near);
    auto *is_beside = work.take<bool>(near);
    StarInView star;
    int stars = 0;
    for (int i = 0; i < std::min(view.near.count, BRIGHT_STARS); ++i) {
        if (see(sky, R, i, view, star)) {
            uv[stars++] = star.uv;
        }
    }
    for (int i = 0; i < count; ++i) {
        left[i] = i;
    }
    count = still_unexplained(centroids, uv, stars, reach_px, reach_sigmas, left, count);
    if (count == 0 || view.near.count <= BRIGHT_STARS) {
        return count;
    }
    // Most are bright stars. Only where others are left the faint ones near them are looked up.
    double sigma_px = 0.0;
    for (int k = 0; k < count; ++k) {
        sigma_px = std::fmax(sigma_px, centroids[left[k]].sigma_px);
    }
    const auto pixel_of = [&](int k) {
        return Point{centroids[left[k]].u_px, centroids[left[k]].v_px};
    };
    mark_beside(R, view, pixel_of, count,
                cos_reach(view, std::fmax(reach_px, reach_sigmas * sigma_px)), is_beside);
    stars = 0;
    for (int i = 0; i < view.near.count; ++i) {
        if (is_beside[i] && see(sky, R, i, view, star)) {
            uv[stars++] = star.uv;
        }
    }
    return still_unexplained(centroids, uv, stars, reach_px, reach_sigmas, left, count);
}

}  // namespace st
