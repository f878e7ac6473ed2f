// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// A file of sections, as startracker_ros/core/stored_arrays.py writes it: header, table of the
// sections, arrays. It is read in place, and not trusted: every offset is checked.

#pragma once

#include <cstddef>
#include <cstdint>

#include "startracker.h"

namespace st {

/// A header of 64 bytes.
struct FileHeader {
    char magic[8];
    uint32_t byte_order;
    uint32_t checksum;  // CRC-32 of all bytes that follow it
    uint64_t bytes;     // of the whole file
    uint32_t layout;
    uint32_t sections;
    uint8_t reserved[32];
};

/// A row of the table behind it: an array of rows x columns, with as many dimensions.
struct FileSection {
    char name[24];
    char type[8];  // as NumPy names it: f8, f4, i8, i4, b1, u1
    uint64_t offset, rows, columns;
    uint32_t dimensions;
    uint32_t reserved;
};

static_assert(sizeof(FileHeader) == 64 && sizeof(FileSection) == 64, "as they are written");

/// The array of a section; data is null where there is none.
struct Section {
    const void *data;
    uint64_t rows;
};

/// Whether header and table are those of a file of this library; the fault names what is not.
bool header_is_sound(const st_sky &file, st_fault *fault);

/// Whether no byte of a file with a sound header has changed.
bool checksum_is_right(const st_sky &file, st_fault *fault);

/// Return the section of a sound header with a name, a type and so many columns, 0 for a list and
/// -1 for a number; of no data where it is missing, of another kind, or beyond the file.
Section section_of(const st_sky &file, const char *name, const char *type, int columns);

/// Fill in a fault, if there is one; return false.
bool refused(st_fault *fault, const char *name, double value, double least, double most);

}  // namespace st
