// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "track/frame_search.h"

#include <algorithm>
#include <cmath>

#include "attitude/results.h"
#include "track/frame_motion.h"
#include "track/rolling_shutter.h"

namespace st {
namespace {

/// Errors of position by a rolling shutter that are tried while the rate is unknown.
constexpr double LITTLE_SHEAR_PX = 0.5, MUCH_SHEAR_PX = 2.0;

/// Of a spot from the disc of its body.
constexpr double MARGIN_PX = 3.0;
/// A body that is fainter by more than a star at its position is not what is seen there; one that is
/// fainter by more than all stars of the image is not seen.
constexpr double FAINTER_MAG = 1.0;

void copy(const st_centroid *from, int count, List<st_centroid> &to) {
    to.clear();
    for (int i = 0; i < count; ++i) {
        to.add(from[i]);
    }
}

/// Leave the stars out that are identified in the light of bodies. Directions are those of the
/// catalogue, of bodies and by the attitude.
void leave_out_bodies(const Lens &lens, const st_observer &observer,
                      const List<st_centroid> &centroids, st_identification &result,
                      List<st_identified> &identified) {
    double faintest = NAN;  // which fmax ignores
    for (const st_identified &one : identified) {
        faintest = std::fmax(faintest, one.magnitude);
    }
    const Matrix3 R = matrix_from_quaternion(quaternion_of(result.attitude.quaternion));
    const double fx = lens.fx * result.focal_ratio, fy = lens.fy * result.focal_ratio;
    const double margin_rad = MARGIN_PX / std::sqrt(fx * fy);
    for (int i = 0; i < identified.count; ++i) {
        const Point distorted{(centroids[i].u_px - lens.cx) / fx,
                              (centroids[i].v_px - lens.cy) / fy};
        const Vector3 seen = R * ray(lens.equidistant, undistort(lens, distorted));
        bool is_body = false;
        for (int k = 0; k < observer.body_count; ++k) {
            const st_body &body = observer.body[k];
            const double reach_rad =
                std::fmin(body.radius_rad + body.error_rad + margin_rad, M_PI);
            is_body |= dot(seen, vector_of(body.direction)) >= std::cos(reach_rad) &&
                       !(identified[i].magnitude < body.magnitude - FAINTER_MAG) &&
                       body.magnitude < faintest + FAINTER_MAG;
        }
        if (is_body) {
            ++result.body_centroids;
            identified[i] = {NAN, NAN, NAN, 0, 0};
        }
    }
}

}  // namespace

FrameSearch::FrameSearch(int most_centroids, Arena &kept)
    : seen_(kept.list<st_centroid>(static_cast<size_t>(most_centroids))),
      moved_(kept.list<st_centroid>(static_cast<size_t>(most_centroids))),
      before_(kept.list<st_centroid>(static_cast<size_t>(most_centroids))) {}

size_t FrameSearch::bytes(int most_centroids) {
    return 3 * Arena::padded<st_centroid>(static_cast<size_t>(most_centroids));
}

size_t FrameSearch::work_bytes(const IdentificationSetup &setup) {
    const auto stars = static_cast<size_t>(setup.most_stars);
    return IdentificationStage::work_bytes(setup) +
           frame_motion_bytes(setup.most_centroids, setup.most_centroids) +
           Arena::padded<Vector3>(stars) + Arena::padded<Point>(stars) +
           2 * Arena::padded<double>(stars);
}

void FrameSearch::reset() {
    searching_ = has_before_ = false;
}

void FrameSearch::begin(int64_t stamp_ns, const st_centroid *centroids, int count,
                        IdentificationStage &stage, Arena &work) {
    stamp_ns_ = stamp_ns;
    copy(centroids, count, seen_);
    copy(centroids, count, moved_);
    searching_ = true;
    if (std::all_of(centroids, centroids + count,
                    [](const st_centroid &one) { return one.delay_s == 0; })) {
        search(Attempt::LAST, stage, work);
        return;
    }
    Vector3 rate_rad_s;
    const double dt_s = static_cast<double>(stamp_ns - before_ns_) * 1e-9;
    const bool moves =
        has_before_ && rate_between_frames(stage.lens(), before_.item, before_.count, seen_.item,
                                           seen_.count, dt_s, rate_rad_s, work);
    copy(centroids, count, before_);
    before_ns_ = stamp_ns;
    has_before_ = true;
    if (moves) {
        move(stage.lens(), rate_rad_s);
    }
    search(moves ? Attempt::BY_FRAME_BEFORE : Attempt::SHEARED_LITTLE, stage, work);
}

void FrameSearch::search(Attempt attempt, IdentificationStage &stage, Arena &work) {
    attempt_ = attempt;
    const double shear_px = attempt == Attempt::SHEARED_LITTLE ? LITTLE_SHEAR_PX
                            : attempt == Attempt::SHEARED_MUCH ? MUCH_SHEAR_PX
                                                               : 0.0;
    stage.begin(stamp_ns_, moved_.item, moved_.count, shear_px, work);
}

/// Move the centroids to the time of the frame.
void FrameSearch::move(const Lens &lens, const Vector3 &rate_rad_s) {
    for (int i = 0; i < seen_.count; ++i) {
        const st_centroid &one = seen_[i];
        const Point at =
            at_frame_time(lens, {one.u_px, one.v_px}, one.delay_s, rate_rad_s, Vector3{});
        moved_[i] = one;
        moved_[i].u_px = at.x;
        moved_[i].v_px = at.y;
        moved_[i].delay_s = 0.0;
    }
}

/// Fill in the rate that explains the residuals of an identification; false without one.
bool FrameSearch::rate_of_residuals(const IdentificationStage &stage,
                                    const st_identification &result, Vector3 &rate_rad_s,
                                    Arena &work) const {
    const Arena::Scope scope(work);
    const ImageStars &stars = stage.stars();
    const auto most = static_cast<size_t>(stars.count);
    auto *icrf = work.take<Vector3>(most);
    auto *uv = work.take<Point>(most);
    auto *sigma_px = work.take<double>(most), *delay_s = work.take<double>(most);
    int known = 0;
    for (int i = 0; i < stars.count; ++i) {
        const int32_t star = stage.found().star[i];
        if (star >= 0) {
            const st_centroid &one = seen_[stars.index[i]];
            icrf[known] = vector_of(stage.uncounted().sky.direction[star]);
            uv[known] = {one.u_px, one.v_px};
            sigma_px[known] = one.sigma_px;
            delay_s[known++] = one.delay_s;
        }
    }
    return fit_rate(stage.lens(), {known, icrf, uv, sigma_px, delay_s},
                    quaternion_of(result.attitude.quaternion), rate_rad_s);
}

void FrameSearch::proceed(double slice_s, const volatile uint32_t *stop,
                          IdentificationStage &stage, ApparentSky *sky, st_identification &result,
                          List<st_identified> &identified, Arena &work) {
    for (double left_s = slice_s; left_s > 0;) {
        const double before_s = stage.work_s();
        stage.proceed(left_s, stop, result, identified, work);
        left_s -= stage.work_s() - before_s;
        if (stage.is_searching()) {
            return;
        }
        const bool found = result.status == ST_IDENTIFIED;
        Vector3 rate_rad_s;
        if (attempt_ == Attempt::LAST || (attempt_ == Attempt::BY_FRAME_BEFORE && found) ||
            result.reason.code == ST_REASON_STOPPED) {
            searching_ = false;
            break;
        }
        if (attempt_ == Attempt::BY_FRAME_BEFORE) {
            copy(seen_.item, seen_.count, moved_);
            search(Attempt::SHEARED_LITTLE, stage, work);
        } else if (found && rate_of_residuals(stage, result, rate_rad_s, work)) {
            move(stage.lens(), rate_rad_s);
            search(Attempt::LAST, stage, work);
        } else {
            search(attempt_ == Attempt::SHEARED_LITTLE ? Attempt::SHEARED_MUCH : Attempt::LAST,
                   stage, work);
        }
    }
    if (searching_) {
        identified.clear();
        result = stage.waiting();
    } else if (result.status == ST_IDENTIFIED && sky != nullptr) {
        look(stamp_ns_, *sky);
        leave_out_bodies(stage.lens(), sky->observer, moved_, result, identified);
    }
}

}  // namespace st
