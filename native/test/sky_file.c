// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#define _POSIX_C_SOURCE 200112L  // posix_memalign

#include "sky_file.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define ALIGNMENT 64
#define ROW 64 /* bytes of the header, and of a row of the table */
#define LAYOUT 1

/* Where the numbers of a row are. */
enum { TYPE = 24, OFFSET = 32, SHAPE = 40, DIMENSIONS = 56 };

static uint64_t padded(uint64_t bytes) {
    return (bytes + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT;
}

uint32_t crc32(const uint8_t *bytes, uint64_t count) {
    uint32_t crc = 0xFFFFFFFFU;
    for (uint64_t i = 0; i < count; ++i) {
        crc ^= bytes[i];
        for (int bit = 0; bit < 8; ++bit) {
            crc = (crc >> 1) ^ ((crc & 1) != 0 ? 0xEDB88320U : 0U);
        }
    }
    return ~crc;
}

uint8_t *sky_copy(const uint8_t *file, uint64_t bytes) {
    void *copy = NULL;
    if (posix_memalign(&copy, ALIGNMENT, bytes + (bytes == 0)) != 0) {
        exit(2);
    }
    memcpy(copy, file, bytes);
    return copy;
}

void sky_seal(uint8_t *file, uint64_t bytes) {
    memcpy(file + SKY_BYTES, &bytes, sizeof bytes);
    const uint32_t checksum = crc32(file + SKY_CHECKED_FROM, bytes - SKY_CHECKED_FROM);
    memcpy(file + SKY_CHECKSUM, &checksum, sizeof checksum);
}

/* ---- sections ---- */

/* Put a number where it is to be, as its type has it; return how many bytes that are. */
static uint64_t put(uint8_t *place, const char *type, double number) {
    if (strcmp(type, "f8") == 0) {
        memcpy(place, &number, sizeof number);
        return sizeof number;
    }
    if (strcmp(type, "f4") == 0) {
        const float single = (float)number;
        memcpy(place, &single, sizeof single);
        return sizeof single;
    }
    if (strcmp(type, "i4") == 0) {
        const int32_t whole = (int32_t)number;
        memcpy(place, &whole, sizeof whole);
        return sizeof whole;
    }
    if (strcmp(type, "b1") == 0 || strcmp(type, "u1") == 0) {
        *place = (uint8_t)number;
        return 1;
    }
    fprintf(stderr, "%s is not a type of a section\n", type);
    exit(2);
}

uint8_t *sky_file(const json *sections, uint64_t *bytes) {
    const uint64_t table = ROW + ROW * sections->count;
    uint64_t most = table;
    for (const json *one = sections->first; one != NULL; one = one->next) {
        size_t count = 0;
        free(json_numbers(json_member(one, "values"), &count));
        most += padded(sizeof(double) * count);
    }
    uint8_t *file = calloc(most, 1);
    if (file == NULL) {
        exit(2);
    }
    const uint32_t byte_order = 0x01020304, layout = LAYOUT, rows = (uint32_t)sections->count;
    memcpy(file, "STARRAYS", 8);
    memcpy(file + 8, &byte_order, sizeof byte_order);
    memcpy(file + 24, &layout, sizeof layout);
    memcpy(file + 28, &rows, sizeof rows);
    uint8_t *row = file + ROW;
    uint64_t end = table;
    for (const json *one = sections->first; one != NULL; one = one->next, row += ROW) {
        size_t dimensions = 0, count = 0;
        const char *type = json_member(one, "type")->text;
        double *shape = json_numbers(json_member(one, "shape"), &dimensions);
        double *values = json_numbers(json_member(one, "values"), &count);
        memcpy(row, one->name, strlen(one->name));
        memcpy(row + TYPE, type, strlen(type));
        memcpy(row + OFFSET, &end, sizeof end);
        for (size_t i = 0; i < dimensions && i < 2; ++i) {
            const uint64_t along = (uint64_t)shape[i];
            memcpy(row + SHAPE + 8 * i, &along, sizeof along);
        }
        const uint32_t dimension_count = (uint32_t)dimensions;
        memcpy(row + DIMENSIONS, &dimension_count, sizeof dimension_count);
        for (size_t i = 0; i < count; ++i) {
            end += put(file + end, type, values[i]);
        }
        end = padded(end);
        free(shape);
        free(values);
    }
    sky_seal(file, end);
    *bytes = end;
    return file;
}

uint8_t *first_sky(const char *corpus, uint64_t *bytes) {
    char path[4096];
    snprintf(path, sizeof path, "%s/sky.json", corpus);
    json *document = json_read(path);
    const json *first = json_member(document, "cases")->first;
    uint8_t *file = sky_file(json_member(json_member(first, "input"), "sections"), bytes);
    json_free(document);
    return file;
}
