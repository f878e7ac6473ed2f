// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/extraction.h"

#include <cmath>
#include <cstring>

#include "centroid/hits.h"
#include "centroid/pointing_error.h"
#include "centroid/psf_sigma.h"
#include "centroid/spots.h"
#include "centroid/streak_search.h"
#include "centroid/streak_stars.h"
#include "centroid/windowed_search.h"
#include "maths/sorting.h"

namespace st {
namespace {

constexpr double FILTER_SIGMA_PX = 1.0;  // while the PSF sigma is unknown
constexpr double FILTER_RATIO = 2.0;     // a filter wrong by more than this factor is replaced
constexpr double NARROWEST_FILTER_PX = 0.5, WIDEST_FILTER_PX = 5.0;
constexpr double WIDE_FILTERS_PX[] = {2.5,
                                      5.0};  // for stars that a narrow filter finds in pieces,
constexpr double MISSHAPEN_SHARE = 0.5;      // if so many spots have another shape, for each star
constexpr int LEAST_WHOLE = 4, MOST_WHOLE = 10;  // as many as were found have more flux, if whole
constexpr double WHOLE_RATIO = 2.0;
constexpr int SPARE_PEAKS = 2;  // peaks fitted per star wanted, as some will be rejected
constexpr int MOST_COMPARED =
    40;  // stars, the brightest, in the search for an error that all share
constexpr double MISSED_SHARE = 0.1;      // misshapen spots for each star,
constexpr double LEAST_MISSED = 2.0;      // and at least
constexpr int SIGMA_IMAGES = 60;          // searched ones, for which a PSF sigma stays known
constexpr double STREAK_SHARE = 0.5;      // of the brightest spots in an image of streaks
constexpr int LEAST_ELONGATED = 4;        // spots that may be streaks of stars,
constexpr double ELONGATED_SHARE = 0.15;  // if there are so many for each star

/// Whether so many spots are longer than stars that these may be streaks.
bool many_elongated(int stars, const Rejections &rejections) {
    const int elongated =
        rejections.by_kind[ST_REJECTED_ELONGATED] + rejections.by_kind[ST_REJECTED_LINE];
    return elongated >= LEAST_ELONGATED && elongated >= ELONGATED_SHARE * stars;
}

int misshapen(const Rejections &rejections) {
    return rejections.by_kind[ST_REJECTED_ELONGATED] + rejections.by_kind[ST_REJECTED_TOO_WIDE] +
           rejections.by_kind[ST_REJECTED_NOT_FITTED];
}

/// Whether so many spots have another shape that the stars may be pieces too.
bool mostly_misshapen(int stars, const Rejections &rejections) {
    const int count = misshapen(rejections);
    return count > MISSHAPEN_SHARE * stars && count > LEAST_ELONGATED;
}

/// Whether so many spots have another shape that stars may be among them.
bool misses_spots(int stars, const Rejections &rejections) {
    const int count = misshapen(rejections);
    return count > MISSED_SHARE * stars && count > LEAST_MISSED;
}

/// Whether streaks explain most of the brightest spots, and no fewer than points.
bool shows_streaks(const List<st_centroid> &spots, const List<st_centroid> &points,
                   const List<st_centroid> &streaks, double longest_px) {
    const int explained = explained_spots(spots, streaks, longest_px / 2);
    const int bright = spots.count < BRIGHT_SPOTS ? spots.count : BRIGHT_SPOTS;
    return explained >= explained_spots(spots, points, 0.0) && explained > STREAK_SHARE * bright;
}

/// Return the flux of the star of a rank, the brightest being 1; zero where there is none.
double flux_of_rank(const List<st_centroid> &stars, int rank, Arena &arena) {
    if (stars.count < rank) {
        return 0.0;
    }
    const Arena::Scope scope(arena);
    auto *flux = arena.take<double>(static_cast<size_t>(stars.count));
    for (int i = 0; i < stars.count; ++i) {
        flux[i] = stars[i].flux_dn;
    }
    return ranked(flux, stars.count, stars.count - rank);
}

/// Whether others are whole where stars are pieces, by the star of a rank.
bool have_more_flux(const List<st_centroid> &others, const List<st_centroid> &stars,
                    Arena &arena) {
    int rank = stars.count > LEAST_WHOLE ? stars.count : LEAST_WHOLE;
    rank = rank < MOST_WHOLE ? rank : MOST_WHOLE;
    return flux_of_rank(others, rank, arena) > WHOLE_RATIO * flux_of_rank(stars, rank, arena);
}

/// Add pixels of a search that are left out.
void add_pixels(Rejections &rejections, st_rejection kind, const List<Pixel> &pixels) {
    for (const Pixel &pixel : pixels) {
        rejections.add(kind, pixel.u, pixel.v);
    }
    rejections.by_kind[kind] += pixels.left_out;
    rejections.spots.left_out += pixels.left_out;
}

Rejections empty_rejections(const ExtractionLimits &limits, Arena &arena) {
    Rejections rejections;
    rejections.spots = arena.list<st_rejected>(static_cast<size_t>(limits.rejected));
    return rejections;
}

/// Replace stars and rejections by others.
void replace(Extraction &found, const Extraction &others) {
    found.stars.clear();
    found.stars.add_all(others.stars);
    found.rejections.clear();
    found.rejections.include(others.rejections);
}

st_reason reason_of(st_reason_code code, double first = 0.0, double second = 0.0,
                    double third = 0.0) {
    return {code, 0, {first, second, third}};
}

/// Return the covariance px^2 of the error that the brightest stars share.
Matrix2 correlated_error(const Frame &frame, double sigma_px, const Extraction &found,
                         Arena &arena) {
    StreakStar stars[MOST_COMPARED];
    const int count = found.stars.count < MOST_COMPARED ? found.stars.count : MOST_COMPARED;
    for (int i = 0; i < count; ++i) {
        const st_centroid &one = found.stars[i];
        const Place place{one.u_px, one.v_px};
        stars[i] =
            found.streaked ? streak_at(place, found.streak.at(place), sigma_px) : StreakStar{};
        stars[i][U] = place.u;
        stars[i][V] = place.v;
        stars[i][FLUX] = one.flux_dn;
        stars[i][SIGMA] = sigma_px;
    }
    return pointing_error(frame.image, frame.mesh, frame.full_scale_dn, stars, count,
                          found.streaked, arena);
}

void set_none(Extraction &found, const st_reason &reason) {
    found.stars.clear();
    found.rejections.clear();
    found.reason = reason;
    found.streaked = false;
}

}  // namespace

bool Extraction::has_correlated_error() const {
    for (const st_centroid &star : stars) {
        if (star.common_uu_px2 != 0.0 || star.common_uv_px2 != 0.0 || star.common_vv_px2 != 0.0) {
            return true;
        }
    }
    return false;
}

ExtractionLimits limits_of(const st_config &config, int width, int height) {
    const st_capacities &given = config.capacities;
    ExtractionLimits limits{};
    limits.peaks = given.peaks > 0 ? given.peaks : most_peaks(width, height);
    limits.stars = limits.peaks + MOST_SPOTS;
    limits.rejected = given.rejected > 0 ? given.rejected : 2 * limits.peaks;
    return limits;
}

Extraction empty_extraction(const ExtractionLimits &limits, Arena &arena) {
    return {arena.list<st_centroid>(static_cast<size_t>(limits.stars)),
            empty_rejections(limits, arena),
            {},
            NAN,
            NAN,
            NAN,
            false,
            {}};
}

KnownSigma KnownSigma::older() const {
    return images >= SIGMA_IMAGES ? KnownSigma{} : KnownSigma{sigma_px, images + 1};
}

void Searched::keep(const Frame &frame) {
    any = true;
    width = frame.image.width;
    height = frame.image.height;
    bits = frame.image.bits;
    kernel = frame.kernel;
    full_scale_dn = frame.full_scale_dn;
    double *level = mesh.level, *noise = mesh.noise;
    const size_t bytes = sizeof(double) * static_cast<size_t>(frame.mesh.size());
    std::memcpy(level, frame.mesh.level, bytes);
    std::memcpy(noise, frame.mesh.noise, bytes);
    mesh = frame.mesh;
    mesh.level = level;
    mesh.noise = noise;
}

/// What the steps of a search know so far.
struct Extractor::Work {
    Frame frame;
    Contamination contamination;
    double sigma_px;
    KnownSigma known;
    int most;
    Arena &arena;
};

Extractor::Extractor(const st_extraction_options &options, const ExtractionLimits &limits,
                     double threshold_factor)
    : options_(options), limits_(limits) {
    const double fixed_dn = options.threshold == ST_THRESHOLD_FIXED ? options.threshold_dn : 0.0;
    threshold_ = {fixed_dn > 0 ? 0.0 : options.threshold_sigma, fixed_dn};
    point_options_ = {static_cast<st_centroid_method>(options.method),
                      {fixed_dn, options.threshold == ST_THRESHOLD_ITERATIVE, threshold_factor},
                      threshold_.sigmas};
    line_time_s_ = options.line_time_us * (options.readout_up != 0 ? -1e-6 : 1e-6);
}

bool Extractor::search(const Image &image, const Streak *streak, const Searched &before,
                       const SearchHow &how, Extraction &found, Searched &after,
                       Arena &arena) const {
    const Arena::Scope scope(arena);
    if (image.width < LEAST_SIDE_PX || image.height < LEAST_SIDE_PX) {
        set_none(found, reason_of(ST_REASON_TOO_SMALL, image.width, image.height, LEAST_SIDE_PX));
        return false;
    }
    const bool known_before = before.fits(image);
    const double given_px = options_.psf_sigma_px;
    Work work{prepared(image, given_px > 0 ? given_px : FILTER_SIGMA_PX, false, arena),
              {},
              0.0,
              known_before && !how.narrow ? before.known.older() : KnownSigma{},
              how.most_stars > 0 ? how.most_stars : options_.max_stars,
              arena};
    Frame &frame = work.frame;
    if (is_blank(frame)) {
        set_none(found, reason_of(ST_REASON_BLANK, image.at(0, 0)));
        return false;
    }
    found.background_dn = frame.background_dn();
    found.noise_dn = frame.noise_dn();
    if (is_saturated(frame)) {
        set_none(found, reason_of(ST_REASON_SATURATED, frame.full_scale_dn));
        return false;
    }
    Rejections taken_out = empty_rejections(limits_, arena);
    clean(work, before, taken_out);
    match_filter(work, how.narrow);
    add_pixels(found.rejections, ST_REJECTED_DISC, frame.search.discs);
    add_pixels(found.rejections, ST_REJECTED_LINE, frame.search.lines);
    bool any_shape = false;
    if (streak == nullptr || streak->longest_px() < SHORTEST_PX) {
        bool smeared = points(frame, work.sigma_px, work.most, found, arena);
        if (!how.points_only) {
            smeared |= many_elongated(found.stars.count, found.rejections);
            any_shape = other_shapes(work, smeared, found);
        }
    } else {
        work.sigma_px = known_before ? before.sigma_px : work.sigma_px;
        streaks(frame, *streak, work.sigma_px, work.most, found, arena);
    }
    if (found.stars.count == 0 && frame.search.too_many()) {
        set_none(found, reason_of(ST_REASON_TOO_MANY_PEAKS, frame.search.found));
        found.background_dn = frame.background_dn();
        found.noise_dn = frame.noise_dn();
        if (!known_before) {
            return false;
        }
        after.keep(frame);
        after.sigma_px = before.sigma_px;
        after.any_shape = before.any_shape;
    } else {
        found.rejections.include(taken_out);
        finish(frame, work.sigma_px, work.most, found, arena);
        after.keep(frame);
        after.sigma_px = work.sigma_px;
        after.any_shape = any_shape;
    }
    after.known = work.known;
    after.contamination = work.contamination;
    return true;
}

void Extractor::search_near(const Image &image, const Place *places, const double *radius_px,
                            int count, const Streak *streak, Searched &searched, Extraction &found,
                            Arena &arena) const {
    const Arena::Scope scope(arena);
    const bool as_streaks = streak != nullptr && streak->longest_px() >= SHORTEST_PX;
    const double share = least_share(searched.sigma_px);
    auto *seen = arena.take<uint8_t>(static_cast<size_t>(count));
    List<Peak> peaks = arena.list<Peak>(static_cast<size_t>(count));
    Frame frame{};
    // Once more where hits are seen that were not known of.
    for (bool again = true; again;) {
        again = false;
        frame = {image, searched.kernel, searched.mesh, {}, searched.full_scale_dn};
        if (searched.contamination.any()) {
            Rejections ignored;
            frame.image = cleaned(image, searched.mesh, searched.contamination, searched.sigma_px,
                                  ignored, arena);
        }
        if (has_changed(searched.mesh, frame.image, places, count, frame.noise_dn())) {
            searched.mesh = mesh_of(frame.image, searched.kernel, searched.contamination.hits,
                                    searched.mesh.level, searched.mesh.noise, arena);
            frame.mesh = searched.mesh;
        }
        if (!as_streaks) {
            peaks.clear();
            const bool hits = peaks_near(frame.image, frame.kernel, frame.mesh, threshold_, places,
                                         radius_px, count, share, peaks, seen, arena);
            again = hits && !searched.contamination.hits;
            searched.contamination.hits |= hits;
        }
    }
    if (as_streaks) {
        measure_streaks(frame, places, count, *streak, searched.sigma_px, threshold_.sigmas,
                        found.stars, found.rejections, arena);
        found.streak = *streak;
    } else {
        for (int i = 0; i < count; ++i) {
            if (seen[i] == 0) {
                found.rejections.add(ST_REJECTED_FAINT, places[i].u, places[i].v);
            }
        }
        measure_points(frame, peaks.item, peaks.count, searched.sigma_px, point_options_,
                       options_.max_stars, found.stars, found.rejections, arena);
        if (searched.any_shape) {
            List<st_centroid> spots = arena.list<st_centroid>(MOST_SPOTS);
            find_spots(frame.image, CELL_SHARE, false, spots, arena);
            add_near_spots(found.stars, spots, places, radius_px, count, arena);
        }
    }
    found.streaked = as_streaks;
    finish(frame, searched.sigma_px, options_.max_stars, found, arena);
}

int Extractor::measure_widths(const Image &image, const Searched &searched, int iterations,
                              FreeStar *stars, int most, Arena &arena) const {
    const Arena::Scope scope(arena);
    Image seen = image;
    if (searched.contamination.any()) {
        Rejections ignored;
        seen = cleaned(image, searched.mesh, searched.contamination, searched.sigma_px, ignored,
                       arena);
    }
    const Frame frame =
        prepared(seen, searched.kernel.sigma_px, searched.contamination.hits, arena);
    const int peaks = frame.search.peaks.count < most ? frame.search.peaks.count : most;
    return fit_free_sigma(
        frame, frame.search.peaks.item, peaks,
        initial_noise_model(frame.background_dn(), frame.noise_dn() * frame.noise_dn()),
        searched.sigma_px, iterations, stars, arena);
}

Frame Extractor::prepared(const Image &image, double filter_px, bool has_hits,
                          Arena &arena) const {
    // Of an image that is smaller than that of the camera there are fewer.
    const int most = most_peaks(image.width, image.height);
    return prepare(image, filter_px, threshold_, most < limits_.peaks ? most : limits_.peaks,
                   has_hits, arena);
}

/// Search the image again without its contamination.
void Extractor::clean(Work &work, const Searched &before, Rejections &taken_out) const {
    Frame &frame = work.frame;
    work.contamination = find_contamination(frame);
    if (!work.contamination.any()) {
        return;
    }
    add_pixels(taken_out, ST_REJECTED_DISC, frame.search.discs);
    add_pixels(taken_out, ST_REJECTED_LINE, frame.search.lines);
    const double sigma_px = before.fits(frame.image) ? before.sigma_px : FILTER_SIGMA_PX;
    const Image image =
        cleaned(frame.image, frame.mesh, work.contamination, sigma_px, taken_out, work.arena);
    frame = prepared(image, frame.kernel.sigma_px, work.contamination.hits, work.arena);
}

/// Measure the PSF sigma; filter the image again where the filter does not match.
void Extractor::match_filter(Work &work, bool narrow) const {
    Frame &frame = work.frame;
    if (frame.search.found == 0) {
        work.sigma_px = options_.psf_sigma_px > 0 ? options_.psf_sigma_px : FILTER_SIGMA_PX;
        return;
    }
    set_psf_sigma(work, narrow);
    const double ratio = work.sigma_px / frame.kernel.sigma_px;
    if (1 / FILTER_RATIO < ratio && ratio < FILTER_RATIO) {
        return;
    }
    const double filter_px =
        work.sigma_px < NARROWEST_FILTER_PX
            ? NARROWEST_FILTER_PX
            : (work.sigma_px < WIDEST_FILTER_PX ? work.sigma_px : WIDEST_FILTER_PX);
    frame = prepared(frame.image, filter_px, false, work.arena);
    set_psf_sigma(work, narrow);
}

/// Set the PSF sigma: where a frame does not show it, the one that is known.
void Extractor::set_psf_sigma(Work &work, bool narrow) const {
    if (options_.psf_sigma_px > 0) {
        work.sigma_px = options_.psf_sigma_px;
        return;
    }
    const PsfSigma measured = measure_psf_sigma(work.frame, narrow, work.arena);
    if (measured.is_certain) {
        work.known = {measured.sigma_px, 0};
    }
    work.sigma_px = work.known.sigma_px > 0 ? work.known.sigma_px : measured.sigma_px;
}

/// Measure the stars among the peaks of a frame; return whether all are smeared.
bool Extractor::points(const Frame &frame, double sigma_px, int most, Extraction &found,
                       Arena &arena) const {
    const Arena::Scope scope(arena);
    const List<Peak> &all = frame.search.peaks;
    const auto capacity = static_cast<size_t>(all.count);
    List<Peak> peaks = arena.list<Peak>(capacity), chosen = arena.list<Peak>(capacity);
    auto *places = arena.take<Place>(capacity);
    auto *good = arena.take<uint8_t>(capacity);
    const double share = least_share(sigma_px < FILTER_SIGMA_PX ? sigma_px : FILTER_SIGMA_PX);
    // Hot pixels are listed ahead of hits of particles.
    for (int i = 0; i < all.count; ++i) {
        const bool hit =
            is_hit(frame.image, all[i], all[i].noise / frame.kernel.noise_gain, share);
        good[i] = hit ? 0 : 1;
        if (!hit) {
            places[peaks.count] = {static_cast<double>(all[i].u), static_cast<double>(all[i].v)};
            peaks.add(all[i]);
        } else if (is_single(frame.image, all[i])) {
            good[i] = 2;
            found.rejections.add(ST_REJECTED_HOT_PIXEL, all[i].u, all[i].v);
        }
    }
    for (int i = 0; i < all.count; ++i) {
        if (good[i] == 0) {
            found.rejections.add(ST_REJECTED_COSMIC_RAY, all[i].u, all[i].v);
        }
    }
    choose(places, peaks.count, frame.image.width, frame.image.height, SPARE_PEAKS * most,
           CELL_SHARE, good);
    for (int i = 0; i < peaks.count; ++i) {
        if (good[i] != 0) {
            chosen.add(peaks[i]);
        }
    }
    Rejections others = empty_rejections(limits_, arena);
    bool smeared = measure_points(frame, chosen.item, chosen.count, sigma_px, point_options_,
                                  chosen.count, found.stars, others, arena);
    if (2 * found.stars.count < most && chosen.count < peaks.count) {
        // What is not a star fills the list of the brightest: all peaks are fitted.
        found.stars.clear();
        others.clear();
        smeared = measure_points(frame, peaks.item, peaks.count, sigma_px, point_options_,
                                 peaks.count, found.stars, others, arena);
    }
    found.rejections.include(others);
    return smeared;
}

/// Where other shapes than points explain more, replace stars and rejections; found has the points.
/// Return whether spots of any shape are among the stars.
bool Extractor::other_shapes(Work &work, bool smeared, Extraction &found) const {
    Arena &arena = work.arena;
    List<st_centroid> spots = arena.list<st_centroid>(MOST_SPOTS);
    bool have_spots = false;
    const FoundStreak shown =
        smeared ? estimate_streak(work.frame, FILTER_SIGMA_PX, arena) : FoundStreak{};
    if (shown.is_found) {
        const Arena::Scope scope(arena);
        find_spots(work.frame.image, CELL_SHARE, false, spots, arena);
        have_spots = true;
        Extraction others = empty_extraction(limits_, arena);
        streaks(work.frame, shown.streak, shown.sigma_px, work.most, others, arena);
        if (others.stars.count > LEAST_ELONGATED && 2 * others.stars.count > found.stars.count &&
            shows_streaks(spots, found.stars, others.stars, shown.streak.length_px())) {
            replace(found, others);
            found.streaked = true;
            found.streak = shown.streak;
            work.sigma_px = shown.sigma_px;
            return false;
        }
    }
    if (mostly_misshapen(found.stars.count, found.rejections)) {
        as_wide(work, found);
    }
    if (!misses_spots(found.stars.count, found.rejections)) {
        return false;
    }
    if (!have_spots) {
        find_spots(work.frame.image, CELL_SHARE, false, spots, arena);
    }
    add_spots(found.stars, spots, work.most, arena);
    return true;
}

/// Take frame and stars after the filter whose stars have the most flux.
void Extractor::as_wide(Work &work, Extraction &found) const {
    if (options_.psf_sigma_px > 0) {
        return;
    }
    Extraction others = empty_extraction(limits_, work.arena);
    for (const double filter_px : WIDE_FILTERS_PX) {
        const Frame wide = prepared(work.frame.image, filter_px, false, work.arena);
        const double sigma_px = measure_psf_sigma(wide, false, work.arena).sigma_px;
        others.stars.clear();
        others.rejections.clear();
        points(wide, sigma_px, work.most, others, work.arena);
        if (have_more_flux(others.stars, found.stars, work.arena)) {
            work.frame = wide;
            work.sigma_px = sigma_px;
            replace(found, others);
        }
    }
}

/// Measure the stars of a smeared frame.
void Extractor::streaks(const Frame &frame, const Streak &streak, double sigma_px, int most,
                        Extraction &found, Arena &arena) const {
    const Arena::Scope scope(arena);
    auto *places = arena.take<Place>(MOST_STREAK_PEAKS);
    auto *good = arena.take<uint8_t>(MOST_STREAK_PEAKS);
    const int count = search_streaks(frame, streak, sigma_px, threshold_.sigmas, places, arena);
    choose(places, count, frame.image.width, frame.image.height, SPARE_PEAKS * most, CELL_SHARE,
           good);
    int chosen = 0;
    for (int i = 0; i < count; ++i) {
        if (good[i] != 0) {
            places[chosen++] = places[i];
        }
    }
    measure_streaks(frame, places, chosen, streak, sigma_px, threshold_.sigmas, found.stars,
                    found.rejections, arena);
    found.streaked = true;
    found.streak = streak;
}

/// Keep the brightest stars; set their delays and their correlated error, and the reason for none.
void Extractor::finish(const Frame &frame, double sigma_px, int most, Extraction &found,
                       Arena &arena) const {
    List<st_centroid> &stars = found.stars;
    sort_by_flux(stars, arena);
    stars.count = stars.count < most ? stars.count : most;
    const double middle = (frame.image.height - 1) / 2.0;
    const Matrix2 correlated = correlated_error(frame, sigma_px, found, arena);
    for (st_centroid &star : stars) {
        star.delay_s = line_time_s_ != 0.0 ? (star.v_px - middle) * line_time_s_ : 0.0;
        star.common_uu_px2 = correlated[0][0];
        star.common_uv_px2 = correlated[0][1];
        star.common_vv_px2 = correlated[1][1];
    }
    found.background_dn = frame.background_dn();
    found.noise_dn = frame.noise_dn();
    found.psf_sigma_px = sigma_px;
    if (stars.count > 0) {
        found.reason = reason_of(ST_NO_REASON);
    } else if (found.rejections.count() > 0) {
        found.reason = reason_of(ST_REASON_ALL_REJECTED, found.rejections.count());
    } else {
        found.reason = reason_of(ST_REASON_NOTHING_ABOVE, threshold_.sigmas, threshold_.dn);
    }
}

size_t work_bytes(int width, int height, const ExtractionLimits &limits) {
    const auto size = static_cast<size_t>(width) * static_cast<size_t>(height);
    const auto peaks = static_cast<size_t>(limits.peaks);
    const size_t frame = 2 * Arena::padded<double>(most_tiles(width, height)) +
                         Arena::padded<Peak>(peaks) + 2 * Arena::padded<Pixel>(2 * peaks) +
                         Arena::padded<uint16_t>(static_cast<size_t>(height));
    const size_t lists = Arena::padded<st_centroid>(static_cast<size_t>(limits.stars)) +
                         Arena::padded<st_rejected>(static_cast<size_t>(limits.rejected));
    // Frames: as it comes, cleaned, with a filter that matches, and with two wide ones. One of the
    // lists is that of a call on the ground.
    return 5 * frame + 5 * lists + Arena::padded<uint16_t>(size) + points_bytes(limits.peaks) +
           streak_search_bytes(width, height) + streak_stars_bytes(MOST_STREAK_PEAKS) +
           3 * Arena::padded<Peak>(peaks) + 28 * size + (size_t{1} << 21);
}

}  // namespace st
