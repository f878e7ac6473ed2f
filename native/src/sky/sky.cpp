// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// What a sky file must have, so that no query reads outside it, whatever it holds.

#include "sky/sky.h"

#include <cmath>

#include "sky/sections.h"

namespace st {
namespace {

constexpr int32_t SKY_VERSION = 1;
constexpr double MOST_STARS = 1e8, MOST_PAIRS = 1e9, MOST_CELLS = 512;
constexpr double LENGTH_ERROR = 1e-9, LARGEST_MOTION_RAD = 1e-3, LARGEST_PARALLAX_RAD = 1e-5;
constexpr double FIRST_YEAR = 1800, LAST_YEAR = 2200;
constexpr double FAINTEST = 30, BRIGHTEST = -30;  // magnitudes, also standard deviations of them

template <class T>
constexpr const char *TYPE = nullptr;
template <>
constexpr const char *TYPE<double> = "f8";
template <>
constexpr const char *TYPE<float> = "f4";
template <>
constexpr const char *TYPE<int32_t> = "i4";
template <>
constexpr const char *TYPE<uint8_t> = "b1";

// --- the sections ---

/// Sections by name, until the first one that is not as it should be.
class Reader {
public:
    Reader(const st_sky &file, st_fault *fault) : file_(file), fault_(fault) {}

    /// Return how many rows a list has, from least to most.
    template <class T>
    int32_t rows(const char *name, double least, double most) {
        const Section section = section_of(file_, name, TYPE<T>, 0);
        const auto count = static_cast<double>(section.rows);
        sound_ = sound_ && section.data != nullptr && count >= least && count <= most
                     ? true
                     : sound_ && refused(fault_, name, count, least, most);
        return sound_ ? static_cast<int32_t>(section.rows) : 0;
    }

    template <class T>
    void list(const char *name, int64_t count, const T *&data) {
        data = static_cast<const T *>(section(name, TYPE<T>, count, 0));
    }

    template <class T>
    void vectors(const char *name, int64_t count, const T (*&data)[3]) {
        data = static_cast<const T(*)[3]>(section(name, TYPE<T>, count, 3));
    }

    template <class T>
    T number(const char *name, double least, double most) {
        const auto *data = static_cast<const T *>(section(name, TYPE<T>, 1, -1));
        if (data == nullptr) {
            return T{};
        }
        const auto value = static_cast<double>(*data);
        sound_ = (value >= least && value <= most) || refused(fault_, name, value, least, most);
        return *data;
    }

    bool is_sound() const { return sound_; }

private:
    const void *section(const char *name, const char *type, int64_t count, int columns) {
        if (!sound_) {
            return nullptr;
        }
        const Section section = section_of(file_, name, type, columns);
        sound_ = section.data != nullptr && section.rows == static_cast<uint64_t>(count);
        if (!sound_) {
            const auto wanted = static_cast<double>(count);
            refused(fault_, name, static_cast<double>(section.rows), wanted, wanted);
        }
        return sound_ ? section.data : nullptr;
    }

    const st_sky &file_;
    st_fault *fault_;
    bool sound_ = true;
};

struct CellNames {
    const char *cells, *start, *member;
};

struct PairNames {
    const char *star, *direction, *separation, *below, *member, *previous;
};

constexpr CellNames STAR_CELLS{"cells", "start", "member"};
constexpr CellNames PATTERN_CELLS{"pattern_cells", "pattern_start", "pattern_member"};
constexpr PairNames ALL_PAIRS{"pair_star",  "pair_direction", "pair_separation",
                              "pair_below", "pair_member",    "pair_previous"};
constexpr PairNames BRIGHT_PAIRS{"bright_star",  "bright_direction", "bright_separation",
                                 "bright_below", "bright_member",    "bright_previous"};

void read_cells(Reader &reader, const CellNames &names, int32_t stars, Cells &cells) {
    cells.cells = reader.number<int32_t>(names.cells, 1, MOST_CELLS);
    const int64_t along = cells.cells;
    reader.list(names.start, along * along * along + 1, cells.start);
    reader.list(names.member, stars, cells.member);
}

void read_pairs(Reader &reader, const PairNames &names, double most_stars, Pairs &pairs) {
    pairs.stars = reader.rows<int32_t>(names.star, 0, most_stars);
    pairs.pairs = reader.rows<double>(names.separation, 0, MOST_PAIRS);
    reader.list(names.star, pairs.stars, pairs.star);
    reader.vectors(names.direction, pairs.stars, pairs.direction);
    reader.list(names.separation, pairs.pairs, pairs.separation_rad);
    reader.list(names.below, int64_t{pairs.pairs} + 1, pairs.below);
    reader.list(names.member, int64_t{2} * pairs.pairs, pairs.member);
    reader.list(names.previous, int64_t{2} * pairs.pairs, pairs.previous);
    if (reader.is_sound()) {
        set_steps(pairs);
    }
}

// --- what is in them ---

/// Whether all values of a list are from least to most, which NaN is not.
template <class T>
bool all_within(const T *values, int64_t count, const char *name, double least, double most,
                st_fault *fault) {
    for (int64_t i = 0; i < count; ++i) {
        const auto value = static_cast<double>(values[i]);
        if (!(value >= least && value <= most)) {
            return refused(fault, name, value, least, most);
        }
    }
    return true;
}

/// Whether no value is less than the one before, or more than the greatest.
template <class T>
bool are_ascending(const T *values, int64_t count, const char *name, double least, double most,
                   st_fault *fault) {
    for (int64_t i = 0; i < count; ++i) {
        const auto value = static_cast<double>(values[i]);
        const double before = i > 0 ? static_cast<double>(values[i - 1]) : least;
        if (!(value >= before && value <= most)) {
            return refused(fault, name, value, before, most);
        }
    }
    return true;
}

bool are_directions(const double (*direction)[3], int32_t count, const char *name,
                    st_fault *fault) {
    for (int32_t i = 0; i < count; ++i) {
        const double *d = direction[i];
        const double length = std::sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
        if (!(std::fabs(length - 1) <= LENGTH_ERROR)) {
            return refused(fault, name, length, 1 - LENGTH_ERROR, 1 + LENGTH_ERROR);
        }
    }
    return true;
}

bool stars_are_sound(const SkyFile &sky, st_fault *fault) {
    const int64_t stars = sky.stars;
    return all_within(sky.hip, stars, "hip", 1, INT32_MAX, fault) &&
           are_directions(sky.direction, sky.stars, "direction", fault) &&
           are_ascending(sky.magnitude, stars, "magnitude", BRIGHTEST, FAINTEST, fault) &&
           all_within(&sky.motion[0][0], 3 * stars, "motion", -LARGEST_MOTION_RAD,
                      LARGEST_MOTION_RAD, fault) &&
           all_within(sky.parallax_rad, stars, "parallax_rad", 0, LARGEST_PARALLAX_RAD, fault) &&
           all_within(sky.variation_mag, stars, "variation_mag", 0, FAINTEST, fault) &&
           all_within(sky.crowded, stars, "crowded", 0, 1, fault) &&
           all_within(sky.blended, stars, "blended", 0, 1, fault);
}

bool cells_are_sound(const Cells &cells, int32_t stars, const CellNames &names, st_fault *fault) {
    const int64_t count = int64_t{cells.cells} * cells.cells * cells.cells;
    return all_within(cells.start, 1, names.start, 0, 0, fault) &&
           are_ascending(cells.start, count, names.start, 0, stars, fault) &&
           all_within(cells.start + count, 1, names.start, stars, stars, fault) &&
           all_within(cells.member, stars, names.member, 0, stars - 1, fault);
}

/// Whether each entry has the one before it of the same star: a walk along them ends.
bool entries_are_linked(const Pairs &pairs, const PairNames &names, st_fault *fault) {
    for (int64_t entry = 0; entry < int64_t{2} * pairs.pairs; ++entry) {
        const int32_t before = pairs.previous[entry], star = pairs.member[entry];
        const auto most = static_cast<double>(entry - 1);
        if (before < -1 || before >= entry) {
            return refused(fault, names.previous, before, -1, most);
        }
        if ((before >= 0 && pairs.member[before] != star) || pairs.member[entry ^ 1] == star) {
            return refused(fault, names.member, star, 0, pairs.stars - 1);
        }
    }
    return true;
}

bool pairs_are_sound(const Pairs &pairs, int32_t stars, const PairNames &names, st_fault *fault) {
    const int64_t count = pairs.pairs;
    return are_ascending(pairs.star, pairs.stars, names.star, 0, stars - 1, fault) &&
           are_directions(pairs.direction, pairs.stars, names.direction, fault) &&
           are_ascending(pairs.separation_rad, count, names.separation, 0, M_PI, fault) &&
           are_ascending(pairs.below, count + 1, names.below, 0, pairs.pairs, fault) &&
           all_within(pairs.member, 2 * count, names.member, 0, pairs.stars - 1, fault) &&
           entries_are_linked(pairs, names, fault);
}

}  // namespace

void set_steps(Pairs &pairs) {
    if (pairs.pairs > 0) {
        // As steps_below() of core/identify/pairs.py, to the bit.
        const double first = pairs.separation_rad[0];
        const double last = pairs.separation_rad[pairs.pairs - 1];
        pairs.first_rad = first;
        pairs.steps_per_rad = 1 / (last > first ? (last - first) / pairs.pairs : 1.0);
    }
}

bool open_sky(const st_sky &file, SkyFile &sky, st_fault *fault) {
    if (!header_is_sound(file, fault)) {
        return false;
    }
    sky = {};
    Reader reader(file, fault);
    reader.number<int32_t>("sky", SKY_VERSION, SKY_VERSION);
    sky.epoch_year = reader.number<double>("epoch_year", FIRST_YEAR, LAST_YEAR);
    sky.pixel_rad = reader.number<double>("pixel_rad", 0, M_PI);
    sky.crowd_rad = reader.number<double>("crowd_rad", 0, M_PI);
    sky.pattern_limit = reader.number<double>("pattern_limit", BRIGHTEST, FAINTEST);
    sky.least_rad = reader.number<double>("least_rad", 0, 2 * M_PI);
    sky.most_rad = reader.number<double>("most_rad", 0, 4 * M_PI);
    sky.stars = reader.rows<int32_t>("hip", 1, MOST_STARS);
    sky.pattern_stars = reader.rows<int32_t>("pattern_member", 1, sky.stars);
    reader.list("hip", sky.stars, sky.hip);
    reader.vectors("direction", sky.stars, sky.direction);
    reader.vectors("motion", sky.stars, sky.motion);
    reader.list("parallax_rad", sky.stars, sky.parallax_rad);
    reader.list("magnitude", sky.stars, sky.magnitude);
    reader.list("variation_mag", sky.stars, sky.variation_mag);
    reader.list("crowded", sky.stars, sky.crowded);
    reader.list("blended", sky.stars, sky.blended);
    read_cells(reader, STAR_CELLS, sky.stars, sky.cells);
    read_cells(reader, PATTERN_CELLS, sky.pattern_stars, sky.pattern_cells);
    read_pairs(reader, ALL_PAIRS, sky.pattern_stars, sky.pairs);
    read_pairs(reader, BRIGHT_PAIRS, sky.pattern_stars, sky.bright_pairs);
    return reader.is_sound();
}

}  // namespace st

using namespace st;

extern "C" st_status st_check_sky(const st_sky *file, st_fault *fault) {
    if (file == nullptr || file->file == nullptr) {
        return ST_NULL_POINTER;
    }
    if (reinterpret_cast<uintptr_t>(file->file) % 64 != 0) {
        return ST_MISALIGNED;
    }
    SkyFile sky;
    const bool sound =
        header_is_sound(*file, fault) && checksum_is_right(*file, fault) &&
        open_sky(*file, sky, fault) && stars_are_sound(sky, fault) &&
        cells_are_sound(sky.cells, sky.stars, STAR_CELLS, fault) &&
        cells_are_sound(sky.pattern_cells, sky.pattern_stars, PATTERN_CELLS, fault) &&
        pairs_are_sound(sky.pairs, sky.pattern_stars, ALL_PAIRS, fault) &&
        pairs_are_sound(sky.bright_pairs, sky.pattern_stars, BRIGHT_PAIRS, fault);
    return sound ? ST_OK : ST_BAD_SKY;
}
