// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/streak_search.h"

#include <cmath>
#include <cstring>

#include "centroid/blur.h"
#include "centroid/connected.h"
#include "centroid/misfit.h"
#include "centroid/streak_fit.h"
#include "maths/lanes.h"
#include "maths/sorting.h"

namespace st {
namespace {

constexpr double SMOOTHING_PX = 1.5;  // before the threshold
constexpr double SPOT_SIGMAS = 4.0;
constexpr int LEAST_SPOT_PX = 8;
constexpr int MOST_SPOTS = 60;       // the brightest
constexpr int MOST_NUMBERS = 16384;  // of spots; more are noise
constexpr double SHORTEST_SPOT_PX = 1.5;
constexpr double LENGTH_SHARE = 0.3, LENGTH_PX = 2.0;  // by which two streaks may differ
constexpr int LEAST_AGREEING = 4;
constexpr double AGREEING_SHARE = 0.3;  // of the flux of all spots
constexpr int FITTED = 12;              // spots, the brightest that agree
constexpr int FIT_ITERATIONS = 12;
constexpr double MOST_LENGTH_ERROR = 0.3;  // of a fit, relative
constexpr double SIGMA_FLOOR_PX = 0.05;
constexpr double LEAST_WEIGHT = 1e-4;  // of the filter, over that of its middle: less is left out
constexpr int NOISE_SAMPLES = 7;       // one pixel of so many along each axis
constexpr int MOST_REACH_PX = 256;     // of the filter; a longer streak is cut
constexpr int BLOCK = 8 * LANES;       // pixels filtered at a time

// --- the streak on which spots agree ---

/// A bright spot: its streak px by its moments.
struct Spot {
    Place place, streak;
    double flux;
};

struct Spots {
    Spot spot[MOST_SPOTS];
    int count = 0;
};

/// Sums over the pixels of a spot, of the weight times 1, u, v, u^2, u v, v^2; and their box.
struct Sums {
    double m[6];
    int left, top, right, bottom, area;
};

/// Reverse the streaks against the direction of most; at(i) is a streak.
template <class At>
void into_half_plane(int count, At at) {
    double sine = 0.0, cosine = 0.0;
    for (int i = 0; i < count; ++i) {
        const double length = std::hypot(at(i).u, at(i).v),
                     angle = 2 * std::atan2(at(i).v, at(i).u);
        sine += length * std::sin(angle);
        cosine += length * std::cos(angle);
    }
    const double axis = std::atan2(sine, cosine) / 2, c = std::cos(axis), s = std::sin(axis);
    for (int i = 0; i < count; ++i) {
        if (at(i).u * c + at(i).v * s < 0) {
            at(i) = {-at(i).u, -at(i).v};
        }
    }
}

/// Return a spot by its sums. The eigenvalues of the moments differ by L^2 / 12, along and across.
Spot spot_of(const Sums &sums) {
    const double *m = sums.m;
    const double u = m[1] / m[0], v = m[2] / m[0];
    const double uu = m[3] / m[0] - u * u, vv = m[5] / m[0] - v * v, uv = m[4] / m[0] - u * v;
    const double difference = std::hypot(uu - vv, 2 * uv);
    const double angle = std::atan2(2 * uv, uu - vv) / 2, length = std::sqrt(12 * difference);
    return {{u, v}, {length * std::cos(angle), length * std::sin(angle)}, m[0]};
}

/// Fill plane with the image less its background.
void above_background(const Frame &frame, const Plane<float> &plane, Arena &arena) {
    const Arena::Scope scope(arena);
    OverImage level(frame.mesh, frame.mesh.level, plane.width, plane.height, arena);
    for (int v = 0; v < plane.height; ++v) {
        const uint16_t *row = frame.image.row(v);
        float *above = plane.row(v);
        level.fill(v, above);
        for (int u = 0; u < plane.width; ++u) {
            above[u] = static_cast<float>(row[u]) - above[u];
        }
    }
}

Sums *spot_sums(const Plane<float> &smooth, const Plane<int32_t> &number, int count,
                Arena &arena) {
    auto *sums = arena.take<Sums>(static_cast<size_t>(count));
    for (int k = 0; k < count; ++k) {
        sums[k] = {{}, smooth.width, smooth.height, 0, 0, 0};
    }
    for (int v = 0; v < smooth.height; ++v) {
        const int32_t *row = number.row(v);
        for (int u = 0; u < smooth.width; ++u) {
            if (row[u] == 0) {
                continue;
            }
            Sums &of = sums[row[u] - 1];
            const double weight = static_cast<double>(smooth.at(u, v)), x = u, y = v;
            const double power[6] = {1.0, x, y, x * x, x * y, y * y};
            for (int k = 0; k < 6; ++k) {
                of.m[k] += weight * power[k];
            }
            of.left = u < of.left ? u : of.left;
            of.top = v < of.top ? v : of.top;
            of.right = u > of.right ? u : of.right;
            of.bottom = v > of.bottom ? v : of.bottom;
            ++of.area;
        }
    }
    return sums;
}

/// Return the brightest spots of the thresholded image that do not touch its border.
Spots bright_spots(const Frame &frame, Arena &arena) {
    const Arena::Scope scope(arena);
    const int width = frame.image.width, height = frame.image.height;
    const auto size = static_cast<size_t>(width) * static_cast<size_t>(height);
    const Plane<float> smooth{arena.take<float>(size), width, height};
    const Plane<int32_t> number{arena.take<int32_t>(size), width, height};
    Spots spots;
    if (number.value == nullptr) {
        return spots;
    }
    above_background(frame, smooth, arena);
    blur(smooth, SMOOTHING_PX, arena);
    const double noise = frame.noise_dn() / (2 * std::sqrt(M_PI) * SMOOTHING_PX);
    const auto threshold = static_cast<float>(SPOT_SIGMAS * noise);
    for (int k = 0; k < smooth.size(); ++k) {
        number.value[k] = smooth.value[k] > threshold ? 1 : 0;
    }
    const int count = connect(number, arena);
    if (count > MOST_NUMBERS) {
        return spots;
    }
    const Sums *sums = spot_sums(smooth, number, count, arena);
    int *order = arena.take<int>(static_cast<size_t>(count));
    int *work = arena.take<int>(static_cast<size_t>(count)), inside = 0;
    for (int k = 0; k < count; ++k) {
        const Sums &one = sums[k];
        if (one.left > 0 && one.top > 0 && one.right < width - 1 && one.bottom < height - 1 &&
            one.area >= LEAST_SPOT_PX) {
            order[inside++] = k;
        }
    }
    sort(order, inside, work, [sums](int a, int b) { return sums[a].m[0] > sums[b].m[0]; });
    for (; spots.count < inside && spots.count < MOST_SPOTS; ++spots.count) {
        spots.spot[spots.count] = spot_of(sums[order[spots.count]]);
    }
    into_half_plane(spots.count, [&spots](int i) -> Place & { return spots.spot[i].streak; });
    return spots;
}

/// Whether another spot has the streak of one, or its opposite.
bool agree(const Spot &one, const Spot &other) {
    const double length = std::hypot(one.streak.u, one.streak.v);
    const double same = std::hypot(one.streak.u - other.streak.u, one.streak.v - other.streak.v);
    const double opposite =
        std::hypot(one.streak.u + other.streak.u, one.streak.v + other.streak.v);
    return std::fmin(same, opposite) < std::fmax(LENGTH_PX, LENGTH_SHARE * length) &&
           length > SHORTEST_SPOT_PX;
}

/// Return the spot with which the brightest group of equal streaks agrees, -1 if that is small. The
/// groups are compared by flux: a long faint streak falls into short pieces, which may be more.
int most_agreed(const Spots &spots) {
    double all = 0.0, most = -1.0;
    int best = -1;
    for (int i = 0; i < spots.count; ++i) {
        double flux = 0.0;
        int agreeing = 0;
        all += spots.spot[i].flux;
        for (int j = 0; j < spots.count; ++j) {
            if (agree(spots.spot[i], spots.spot[j])) {
                flux += spots.spot[j].flux;
                ++agreeing;
            }
        }
        if (agreeing >= LEAST_AGREEING && flux > most) {
            most = flux;
            best = i;
        }
    }
    return most < AGREEING_SHARE * all ? -1 : best;
}

// --- the filter of a streak ---

/// The flux of a unit streak about the middle of an image: rows of weights, those from first to
/// end - 1 of which count.
struct StreakKernel {
    int across, down;
    float *weight;
    int *first, *end;

    int columns() const { return 2 * across + 1; }
    int rows() const { return 2 * down + 1; }
    float *row(int y) const { return weight + static_cast<ptrdiff_t>(y) * columns(); }
};

int reach_of(double streak_px, double sigma_px) {
    const double reach = std::ceil(std::fabs(streak_px) / 2 + (2.5 * sigma_px + 1));
    return reach < MOST_REACH_PX ? static_cast<int>(reach) : MOST_REACH_PX;
}

/// Return the kernel over its energy: the filtered image is the flux.
StreakKernel kernel_of(const Streak &streak, double sigma_px, Arena &arena) {
    StreakKernel kernel{};
    kernel.across = reach_of(streak.u_px, sigma_px);
    kernel.down = reach_of(streak.v_px, sigma_px);
    const int rows = kernel.rows(), columns = kernel.columns();
    kernel.weight = arena.take<float>(static_cast<size_t>(rows) * static_cast<size_t>(columns));
    kernel.first = arena.take<int>(static_cast<size_t>(rows));
    kernel.end = arena.take<int>(static_cast<size_t>(rows));
    StreakStar star = streak_at({0.0, 0.0}, {streak.u_px, streak.v_px}, sigma_px);
    const StreakShape shape(star);
    const double least = LEAST_WEIGHT * shape.share_at(0.0, 0.0);
    double energy = 0.0;
    for (int y = 0; y < rows; ++y) {
        float *row = kernel.row(y);
        kernel.first[y] = columns;
        kernel.end[y] = 0;
        for (int x = 0; x < columns; ++x) {
            const double share = shape.share_at(x - kernel.across, y - kernel.down);
            row[x] = static_cast<float>(share);
            energy += share * share;
            if (share > least) {
                kernel.first[y] = kernel.first[y] < x ? kernel.first[y] : x;
                kernel.end[y] = x + 1;
            }
        }
    }
    for (int k = 0; k < rows * columns; ++k) {
        kernel.weight[k] = static_cast<float>(static_cast<double>(kernel.weight[k]) / energy);
    }
    return kernel;
}

/// Fill target (width) with the filtered row whose lines of the kernel are given, each extended by
/// its reach across on both sides, and further to a whole block.
void filter_row(const StreakKernel &kernel, const float *const *line, int width, float *target) {
    for (int x = 0; x < width; x += BLOCK) {
        // So many sums that none waits for the one before.
        Lanes a{}, b{}, c{}, d{}, e{}, f{}, g{}, h{};
        for (int y = 0; y < kernel.rows(); ++y) {
            const float *row = kernel.row(y), *from = line[y] + x;
            for (int k = kernel.first[y]; k < kernel.end[y]; ++k) {
                const Lanes weight = all_of(row[k]);
                a += weight * load(&from[k]);
                b += weight * load(&from[k + LANES]);
                c += weight * load(&from[k + 2 * LANES]);
                d += weight * load(&from[k + 3 * LANES]);
                e += weight * load(&from[k + 4 * LANES]);
                f += weight * load(&from[k + 5 * LANES]);
                g += weight * load(&from[k + 6 * LANES]);
                h += weight * load(&from[k + 7 * LANES]);
            }
        }
        const Lanes sums[BLOCK / LANES] = {a, b, c, d, e, f, g, h};
        const int whole = width - x < BLOCK ? width - x : BLOCK;
        std::memcpy(target + x, sums, static_cast<size_t>(whole) * sizeof(float));
    }
}

/// Replace plane by itself after the filter; the image is mirrored at its borders.
void filter(const Plane<float> &plane, const StreakKernel &kernel, Arena &arena) {
    const Arena::Scope scope(arena);
    const int width = plane.width, height = plane.height, kept = kernel.rows();
    const int extended = width + 2 * kernel.across + BLOCK;
    const auto length = static_cast<size_t>(extended);
    auto *lines = arena.take<float>(length * static_cast<size_t>(kept));
    auto **line = arena.take<const float *>(static_cast<size_t>(kept));
    const auto line_of = [=](int v) {
        return lines + static_cast<ptrdiff_t>(v % kept) * extended;
    };
    for (int below = 0; below < height + kernel.down; ++below) {
        if (below < height) {
            const float *row = plane.row(below);
            float *extension = line_of(below);
            for (int x = 0; x < extended; ++x) {
                const int u = x - kernel.across;
                extension[x] = row[0 <= u && u < width ? u : mirrored(u, width)];
            }
        }
        const int v = below - kernel.down;
        if (v >= 0) {
            for (int y = 0; y < kept; ++y) {
                line[y] = line_of(mirrored(v + y - kernel.down, height));
            }
            filter_row(kernel, line, width, plane.row(v));
        }
    }
}

/// Return the noise of an image by a part of its pixels.
double noise_of(const Plane<float> &flux, Arena &arena) {
    const Arena::Scope scope(arena);
    const int most = (flux.width / NOISE_SAMPLES + 1) * (flux.height / NOISE_SAMPLES + 1);
    auto *sample = arena.take<float>(static_cast<size_t>(most));
    int count = 0;
    for (int v = 0; v < flux.height; v += NOISE_SAMPLES) {
        for (int u = 0; u < flux.width; u += NOISE_SAMPLES) {
            sample[count++] = flux.at(u, v);
        }
    }
    const auto level = static_cast<float>(median(sample, count));
    for (int k = 0; k < count; ++k) {
        sample[k] = std::fabs(sample[k] - level);
    }
    return SIGMA_PER_MAD * median(sample, count);
}

struct FluxPeak {
    float flux;
    int u, v;
};

/// Whether no pixel around this one is brighter.
bool is_top(const Plane<float> &flux, int u, int v) {
    const float here = flux.at(u, v);
    for (int y = v > 0 ? v - 1 : 0; y <= v + 1 && y < flux.height; ++y) {
        for (int x = u > 0 ? u - 1 : 0; x <= u + 1 && x < flux.width; ++x) {
            if (flux.at(x, y) > here) {
                return false;
            }
        }
    }
    return true;
}

/// Fill peaks, of room for MOST_STREAK_PEAKS, with those above a threshold, the brightest first;
/// equal ones keep their order. Return how many there are.
int find_peaks(const Plane<float> &flux, float threshold, FluxPeak *peaks) {
    int count = 0;
    for (int v = 0; v < flux.height; ++v) {
        for (int u = 0; u < flux.width; ++u) {
            const float here = flux.at(u, v);
            if (!(here > threshold) || !is_top(flux, u, v) ||
                (count == MOST_STREAK_PEAKS && !(here > peaks[count - 1].flux))) {
                continue;
            }
            int slot = count < MOST_STREAK_PEAKS ? count++ : count - 1;
            for (; slot > 0 && here > peaks[slot - 1].flux; --slot) {
                peaks[slot] = peaks[slot - 1];
            }
            peaks[slot] = {here, u, v};
        }
    }
    return count;
}

/// Keep the peaks, brightest first, that are no side lobes of brighter ones; return how many.
int keep_alone(const FluxPeak *peaks, int count, const Streak &streak, double sigma_px,
               Place *places, Arena &arena) {
    const Arena::Scope scope(arena);
    auto *flux = arena.take<double>(static_cast<size_t>(count));
    int kept = 0;
    for (int i = 0; i < count; ++i) {
        const Place place{static_cast<double>(peaks[i].u), static_cast<double>(peaks[i].v)};
        const Place moved = streak.at(place);
        const double length = std::hypot(moved.u, moved.v), divisor = std::fmax(length, 1e-9);
        const double c = moved.u / divisor, s = moved.v / divisor;
        const double here = static_cast<double>(peaks[i].flux);
        bool alone = true;
        for (int j = 0; alone && j < kept; ++j) {
            const double u = place.u - places[j].u, v = place.v - places[j].v;
            const double a = std::fabs(u * c + v * s), b = std::fabs(v * c - u * s);
            if (a < length + 3 * sigma_px && b < 3 * sigma_px + 1) {
                alone = here > 1.5 * (flux[j] * std::fmax(1 - a / divisor, 0.1));
            }
        }
        if (alone) {
            flux[kept] = here;
            places[kept++] = place;
        }
    }
    return kept;
}

}  // namespace

FoundStreak estimate_streak(const Frame &frame, double sigma_px, Arena &arena) {
    const Arena::Scope scope(arena);
    const FoundStreak none{{}, 0.0, false};
    const Spots spots = bright_spots(frame, arena);
    const int best = most_agreed(spots);
    if (best < 0) {
        return none;
    }
    StreakFit<7> fit[FITTED];
    Sky sky[FITTED];
    const double variance = frame.noise_dn() * frame.noise_dn();
    int count = 0;
    for (int j = 0; j < spots.count && count < FITTED; ++j) {
        const Spot &spot = spots.spot[j];
        if (agree(spots.spot[best], spot)) {
            fit[count].star = streak_at(spot.place, spot.streak, sigma_px);
            fit[count].star[FLUX] = spot.flux;
            sky[count++] = sky_at(frame.mesh, spot.place, variance);
        }
    }
    const StreakPixels pixels{frame.image, frame.full_scale_dn, sky};
    const NoiseModel noise = initial_noise_model(frame.background_dn(), variance);
    fit_streaks(pixels, fit, count, noise, FIT_ITERATIONS, arena);
    Place places[FITTED], streaks[FITTED];
    double weight[FITTED], sigma[FITTED];
    int good = 0;
    for (int i = 0; i < count; ++i) {
        const StreakStar &star = fit[i].star;
        const double length = star[LENGTH], of_length = fit[i].covariance[LENGTH][LENGTH];
        const double most = MOST_LENGTH_ERROR * length;
        if (misfit(fit[i].chi2, fit[i].dof, star[FLUX], fit[i].covariance[FLUX][FLUX]) <
                MOST_MISFIT &&
            of_length > 0 && of_length < most * most && length > SHORTEST_SPOT_PX) {
            places[good] = {star[U], star[V]};
            streaks[good] = {length * std::cos(star[ANGLE]), length * std::sin(star[ANGLE])};
            weight[good] = 1 / (of_length + SIGMA_FLOOR_PX * SIGMA_FLOOR_PX);
            sigma[good++] = star[SIGMA];
        }
    }
    if (good < LEAST_AGREEING - 1) {
        return none;
    }
    into_half_plane(good, [&streaks](int i) -> Place & { return streaks[i]; });
    return {fit_streak(places, streaks, weight, good, frame.image.width, frame.image.height),
            median(sigma, good), true};
}

int search_streaks(const Frame &frame, const Streak &streak, double sigma_px,
                   double threshold_sigmas, Place *places, Arena &arena) {
    const Arena::Scope scope(arena);
    const int width = frame.image.width, height = frame.image.height;
    const Plane<float> flux{
        arena.take<float>(static_cast<size_t>(width) * static_cast<size_t>(height)), width,
        height};
    auto *peaks = arena.take<FluxPeak>(MOST_STREAK_PEAKS);
    // No row or column is mirrored in itself.
    if (peaks == nullptr || width < 2 || height < 2) {
        return 0;
    }
    above_background(frame, flux, arena);
    filter(flux, kernel_of(streak, sigma_px, arena), arena);
    const double noise = noise_of(flux, arena);
    const int count = find_peaks(flux, static_cast<float>(threshold_sigmas * noise), peaks);
    return keep_alone(peaks, count, streak, sigma_px, places, arena);
}

size_t streak_search_bytes(int width, int height) {
    const auto w = static_cast<size_t>(width), h = static_cast<size_t>(height);
    const size_t reach = MOST_REACH_PX, rows = 2 * reach + 1;
    // Of the background, of the blur and of the numbers of spots; they follow each other.
    const size_t image = Arena::padded<float>(w * h);
    const size_t spots = 2 * image + Arena::padded<int32_t>((w + 1) / 2 * ((h + 1) / 2) + 1) +
                         Arena::padded<Sums>(MOST_NUMBERS) + 2 * Arena::padded<int>(MOST_NUMBERS);
    const size_t blurred = 2 * image + 34 * Arena::padded<float>(w + 64);
    const size_t search =
        image + Arena::padded<FluxPeak>(MOST_STREAK_PEAKS) + Arena::padded<float>(rows * rows) +
        2 * Arena::padded<int>(rows) + Arena::padded<float>((w + 2 * reach + BLOCK) * rows) +
        Arena::padded<const float *>(rows) + Arena::padded<float>((w / 7 + 1) * (h / 7 + 1)) +
        Arena::padded<double>(MOST_STREAK_PEAKS);
    const size_t most = spots > blurred ? spots : blurred;
    return (most > search ? most : search) + streak_fit_bytes(FITTED);
}

}  // namespace st
