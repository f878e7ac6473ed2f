// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

/* Messages of the application startracker_app. Topics are the mission's to change. */

#ifndef STARTRACKER_APP_H
#define STARTRACKER_APP_H

#include "cfe.h"
#include "cfe_core_api_base_msgids.h"

#define STARTRACKER_IMAGE_MID CFE_PLATFORM_CMD_TOPICID_TO_MIDV(0x90)
#define STARTRACKER_RATE_MID CFE_PLATFORM_CMD_TOPICID_TO_MIDV(0x91)
#define STARTRACKER_ATTITUDE_MID CFE_PLATFORM_TLM_TOPICID_TO_MIDV(0x90)

/* The pixels stay where the camera application has them until the attitude of this stamp is sent. */
typedef struct {
    CFE_MSG_CommandHeader_t Header;
    int64 StampNs;
    const uint16 *Pixels;
} STARTRACKER_Image_t;

/* Of a gyro, about the axes of the sensor. */
typedef struct {
    CFE_MSG_CommandHeader_t Header;
    int64 StampNs;
    double RateRadS[3];
} STARTRACKER_Rate_t;

/* As st_attitude; not valid: the numbers are NaN, and Reason says why. */
typedef struct {
    CFE_MSG_TelemetryHeader_t Header;
    int64 StampNs;
    double Quaternion[4], CovarianceRad2[9], RateRadS[3], ProtectionRad[3];
    int32 Valid, Reason;
} STARTRACKER_Attitude_t;

#endif
