// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "sky/sections.h"

#include <array>
#include <cstring>

namespace st {
namespace {

constexpr char MAGIC[9] = "STARRAYS";
constexpr uint32_t BYTE_ORDER_MARK = 0x01020304, LAYOUT = 1, MOST_SECTIONS = 1000;
constexpr uint64_t ALIGNMENT = 64, CHECKED_FROM = offsetof(FileHeader, bytes);

// --- CRC-32 of ISO 3309 (that of zlib), eight bytes at a time ---

constexpr int STRIDE = 8;
using CrcTables = std::array<std::array<uint32_t, 256>, STRIDE>;

constexpr CrcTables crc_tables() {
    CrcTables tables{};
    for (uint32_t byte = 0; byte < 256; ++byte) {
        uint32_t crc = byte;
        for (int bit = 0; bit < 8; ++bit) {
            crc = (crc >> 1) ^ ((crc & 1) != 0 ? 0xEDB88320U : 0U);
        }
        tables[0][byte] = crc;
    }
    for (uint32_t byte = 0; byte < 256; ++byte) {
        for (size_t n = 1; n < STRIDE; ++n) {
            const uint32_t before = tables[n - 1][byte];
            tables[n][byte] = (before >> 8) ^ tables[0][before & 0xFF];
        }
    }
    return tables;
}

constexpr CrcTables TABLES = crc_tables();

uint32_t crc32(const uint8_t *bytes, uint64_t count) {
    uint32_t crc = 0xFFFFFFFFU;
    for (; count >= STRIDE; bytes += STRIDE, count -= STRIDE) {
        // By bytes: the order of those in a word differs between processors.
        crc ^= static_cast<uint32_t>(bytes[0]) | static_cast<uint32_t>(bytes[1]) << 8 |
               static_cast<uint32_t>(bytes[2]) << 16 | static_cast<uint32_t>(bytes[3]) << 24;
        crc = TABLES[7][crc & 0xFF] ^ TABLES[6][(crc >> 8) & 0xFF] ^
              TABLES[5][(crc >> 16) & 0xFF] ^ TABLES[4][crc >> 24] ^ TABLES[3][bytes[4]] ^
              TABLES[2][bytes[5]] ^ TABLES[1][bytes[6]] ^ TABLES[0][bytes[7]];
    }
    for (; count > 0; ++bytes, --count) {
        crc = (crc >> 8) ^ TABLES[0][(crc ^ *bytes) & 0xFF];
    }
    return ~crc;
}

// --- the table ---

const FileHeader &header_of(const st_sky &file) {
    return *static_cast<const FileHeader *>(file.file);
}

const FileSection *table_of(const st_sky &file) {
    return reinterpret_cast<const FileSection *>(static_cast<const uint8_t *>(file.file) +
                                                 sizeof(FileHeader));
}

template <size_t N>
bool is_named(const char (&field)[N], const char *name) {
    return std::strncmp(field, name, N) == 0;
}

}  // namespace

bool refused(st_fault *fault, const char *name, double value, double least, double most) {
    if (fault != nullptr) {
        *fault = {name, value, least, most};
    }
    return false;
}

bool header_is_sound(const st_sky &file, st_fault *fault) {
    const auto bytes = static_cast<double>(file.bytes);
    if (file.bytes < sizeof(FileHeader)) {
        return refused(fault, "bytes of the file", bytes, sizeof(FileHeader), 1e18);
    }
    const FileHeader &header = header_of(file);
    if (std::memcmp(header.magic, MAGIC, sizeof header.magic) != 0) {
        return refused(fault, "first byte of a sky file", static_cast<uint8_t>(header.magic[0]),
                       MAGIC[0], MAGIC[0]);
    }
    if (header.byte_order != BYTE_ORDER_MARK) {
        return refused(fault, "mark of the byte order", header.byte_order, BYTE_ORDER_MARK,
                       BYTE_ORDER_MARK);
    }
    if (header.layout != LAYOUT) {
        return refused(fault, "version of the layout", header.layout, LAYOUT, LAYOUT);
    }
    if (header.bytes != file.bytes) {
        const auto written = static_cast<double>(header.bytes);
        return refused(fault, "bytes of the file", bytes, written, written);
    }
    const auto capacity = (file.bytes - sizeof(FileHeader)) / sizeof(FileSection);
    const uint64_t most = capacity < MOST_SECTIONS ? capacity : MOST_SECTIONS;
    return header.sections <= most ||
           refused(fault, "sections of the file", header.sections, 0, static_cast<double>(most));
}

bool checksum_is_right(const st_sky &file, st_fault *fault) {
    const uint32_t expected = header_of(file).checksum;
    const uint32_t found =
        crc32(static_cast<const uint8_t *>(file.file) + CHECKED_FROM, file.bytes - CHECKED_FROM);
    return found == expected || refused(fault, "checksum of the file", found, expected, expected);
}

Section section_of(const st_sky &file, const char *name, const char *type, int columns) {
    const uint64_t size =
        static_cast<uint64_t>(type[1] - '0') * static_cast<uint64_t>(columns > 0 ? columns : 1);
    for (uint32_t n = 0; n < header_of(file).sections; ++n) {
        const FileSection &section = table_of(file)[n];
        if (!is_named(section.name, name)) {
            continue;
        }
        const uint64_t rows = columns < 0 ? 1 : section.rows;
        const bool of_kind = is_named(section.type, type) &&
                             section.dimensions == (columns < 0    ? 0U
                                                    : columns == 0 ? 1U
                                                                   : 2U) &&
                             (columns <= 0 || section.columns == static_cast<uint64_t>(columns));
        if (of_kind && section.offset % ALIGNMENT == 0 && section.offset <= file.bytes &&
            rows <= (file.bytes - section.offset) / size) {
            return {static_cast<const uint8_t *>(file.file) + section.offset, rows};
        }
        break;
    }
    return {nullptr, 0};
}

}  // namespace st
