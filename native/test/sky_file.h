// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

/* Sky files out of the conformance corpus. */

#ifndef STARTRACKER_TEST_SKY_FILE_H
#define STARTRACKER_TEST_SKY_FILE_H

#include <stdint.h>

#include "json.h"

/* Where numbers of the header are, and the first byte that the checksum is of. */
enum { SKY_CHECKSUM = 12, SKY_BYTES = 16, SKY_CHECKED_FROM = SKY_BYTES };

/* The file of the sections of an input, as the README of the corpus has its layout; a section that
 * is not of a known type ends the program. The caller frees it. */
uint8_t *sky_file(const json *sections, uint64_t *bytes);

/* That of the first case of sky.json in the folder of the corpus. The caller frees it. */
uint8_t *first_sky(const char *corpus, uint64_t *bytes);

/* CRC-32 of ISO 3309. */
uint32_t crc32(const uint8_t *bytes, uint64_t count);

/* A copy of the first bytes of a file, aligned to 64 bytes, without a byte to spare: what is read
 * beyond it a sanitizer sees. The caller frees it. */
uint8_t *sky_copy(const uint8_t *file, uint64_t bytes);

/* Write what the header says of a file, at least 64 bytes of it: how many there are, and their
 * checksum. */
void sky_seal(uint8_t *file, uint64_t bytes);

#endif
