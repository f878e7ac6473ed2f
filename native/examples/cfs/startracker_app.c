// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

/*
 * A star tracker as a cFS application: images and rates from the software bus, attitudes to it. The
 * sky file is read once, at the start. Its stack in the startup script: 65536 bytes.
 */

#include "startracker_app.h"

#include <string.h>

#include "startracker.h"

#define SKY_FILE "/cf/camera.sky"

enum { WIDTH_PX = 1024, HEIGHT_PX = 1024, PIPE_DEPTH = 16, FAILED_EID = 1, READY_EID = 2 };

/* By docs/flight.md, with what this camera needs; too little is said at the start. */
static uint8 Memory[64 << 20] __attribute__((aligned(64)));
static uint8 SkyFile[32 << 20] __attribute__((aligned(64)));
static st_tracker *Tracker;
static CFE_SB_PipeId_t Pipe;

static CFE_Status_t Failed(const char *What, const char *Why) {
    CFE_EVS_SendEvent(FAILED_EID, CFE_EVS_EventType_ERROR, "startracker: %s: %s", What, Why);
    return CFE_STATUS_EXTERNAL_RESOURCE_FAIL;
}

static CFE_Status_t ReadSky(st_sky *Sky) {
    osal_id_t File;
    int32 Count = 1;
    if (OS_OpenCreate(&File, SKY_FILE, OS_FILE_FLAG_NONE, OS_READ_ONLY) != OS_SUCCESS) {
        return Failed(SKY_FILE, "there is no such file");
    }
    Sky->file = SkyFile;
    for (Sky->bytes = 0; Count > 0 && Sky->bytes < sizeof SkyFile; Sky->bytes += (uint64)Count) {
        Count = OS_read(File, SkyFile + Sky->bytes, sizeof SkyFile - Sky->bytes);
        Count = Count > 0 ? Count : 0;
    }
    OS_close(File);
    return CFE_SUCCESS;
}

static CFE_Status_t MakeTracker(void) {
    static const st_abi Abi = ST_ABI;
    static st_config Config;
    /* Of `startracker calibrate`. */
    static const st_camera Camera = {.width_px = WIDTH_PX,
                                     .height_px = HEIGHT_PX,
                                     .fx_px = 4871.4,
                                     .fy_px = 4871.4,
                                     .cx_px = 511.5,
                                     .cy_px = 511.5,
                                     .model = ST_PLUMB_BOB};
    st_fault Fault = {.name = "sky"};
    st_sky Sky;
    if (ReadSky(&Sky) != CFE_SUCCESS) {
        return CFE_STATUS_EXTERNAL_RESOURCE_FAIL;
    }
    st_status Status = st_check_sky(&Sky, &Fault);
    if (Status == ST_OK) {
        Status = st_defaults(&Config, &Abi);
    }
    if (Status == ST_OK) {
        Status = st_create(Memory, sizeof Memory, &Config, &Camera, &Sky, &Tracker, &Fault);
    }
    return Status == ST_OK ? CFE_SUCCESS : Failed(Fault.name, st_status_text(Status));
}

static CFE_Status_t Init(void) {
    CFE_Status_t Status = CFE_EVS_Register(NULL, 0, CFE_EVS_EventFilter_BINARY);
    if (Status == CFE_SUCCESS) {
        Status = CFE_SB_CreatePipe(&Pipe, PIPE_DEPTH, "STARTRACKER");
    }
    if (Status == CFE_SUCCESS) {
        Status = CFE_SB_Subscribe(CFE_SB_ValueToMsgId(STARTRACKER_IMAGE_MID), Pipe);
    }
    if (Status == CFE_SUCCESS) {
        Status = CFE_SB_Subscribe(CFE_SB_ValueToMsgId(STARTRACKER_RATE_MID), Pipe);
    }
    if (Status == CFE_SUCCESS) {
        Status = MakeTracker();
    }
    if (Status == CFE_SUCCESS) {
        CFE_EVS_SendEvent(READY_EID, CFE_EVS_EventType_INFORMATION, "startracker: %s",
                          st_build_text());
    }
    return Status;
}

static void ProcessImage(const STARTRACKER_Image_t *Message) {
    static st_result Result;
    static STARTRACKER_Attitude_t Out;
    const st_image Image = {.pixels = Message->Pixels,
                            .stride_bytes = 2 * WIDTH_PX,
                            .width_px = WIDTH_PX,
                            .height_px = HEIGHT_PX,
                            .type = ST_GREY16,
                            .cell = 1};
    const st_status Status = st_process_image(Tracker, Message->StampNs, &Image, &Result);
    if (Status != ST_OK) {
        Failed("image", st_status_text(Status));
        return;
    }
    const st_attitude *Attitude = &Result.attitude;
    CFE_MSG_Init(CFE_MSG_PTR(Out.Header), CFE_SB_ValueToMsgId(STARTRACKER_ATTITUDE_MID),
                 sizeof Out);
    Out.StampNs = Message->StampNs;
    memcpy(Out.Quaternion, Attitude->quaternion, sizeof Out.Quaternion);
    memcpy(Out.CovarianceRad2, Attitude->covariance_rad2, sizeof Out.CovarianceRad2);
    memcpy(Out.RateRadS, Attitude->rate_rad_s, sizeof Out.RateRadS);
    memcpy(Out.ProtectionRad, Attitude->protection_rad, sizeof Out.ProtectionRad);
    Out.Valid = Attitude->valid;
    Out.Reason = Result.reason.code;
    CFE_SB_TimeStampMsg(CFE_MSG_PTR(Out.Header));
    CFE_SB_TransmitMsg(CFE_MSG_PTR(Out.Header), true);
}

/* The entry point, in the startup script. */
void STARTRACKER_Main(void);
void STARTRACKER_Main(void) {
    uint32 RunStatus =
        Init() == CFE_SUCCESS ? CFE_ES_RunStatus_APP_RUN : CFE_ES_RunStatus_APP_ERROR;
    while (CFE_ES_RunLoop(&RunStatus)) {
        CFE_SB_Buffer_t *Buffer;
        CFE_SB_MsgId_t Id = CFE_SB_INVALID_MSG_ID;
        if (CFE_SB_ReceiveBuffer(&Buffer, Pipe, CFE_SB_PEND_FOREVER) != CFE_SUCCESS) {
            RunStatus = CFE_ES_RunStatus_APP_ERROR;
            continue;
        }
        CFE_MSG_GetMsgId(&Buffer->Msg, &Id);
        if (CFE_SB_MsgIdToValue(Id) == STARTRACKER_IMAGE_MID) {
            ProcessImage((const STARTRACKER_Image_t *)Buffer);
        } else {
            const STARTRACKER_Rate_t *Rate = (const STARTRACKER_Rate_t *)Buffer;
            st_add_rate(Tracker, Rate->StampNs, Rate->RateRadS);
        }
    }
    CFE_ES_ExitApp(RunStatus);
}
