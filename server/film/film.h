// Films of rendered frames: the interface of a module that the runner loads when the first film is
// asked for. The module alone knows FFmpeg's libraries; without it all else works.
#ifndef RN_SERVER_FILM_FILM_H
#define RN_SERVER_FILM_FILM_H

#include <stdbool.h>
#include <stdint.h>

#include "common/base/status.h"

enum rn_film_codec { RN_FILM_H264, RN_FILM_AV1, RN_FILM_VP9, RN_FILM_GIF, RN_FILM_CODECS };

#define RN_FILM_VERSION 1
#define RN_FILM_SYMBOL "rn_film_module"

struct rn_film_spec {
    const char *file; // to write; what is there is replaced
    enum rn_film_codec codec;
    int width, height; // pixels of a frame; all but GIF leave out an odd last row or column
    double fps;        // frames a second
    int quality;       // 0 smallest .. 100 best
    int threads;       // 0: as many as there are processors
};

struct rn_film; // one film being made. Thread-safety: one thread.

// All frames go through `add` `passes` times, in order. Thread-safety: constant.
struct rn_film_module {
    int version; // RN_FILM_VERSION
    // RN_ERROR_UNSUPPORTED: no encoder of this codec is there; RN_ERROR_INVALID: not for this size
    // or rate. On success *ret_film is to be closed.
    enum rn_status (*open)(const struct rn_film_spec *spec, struct rn_film **ret_film,
                           int *ret_passes, struct rn_error *err);
    // RGBA, width * height * 4 bytes, rows from the top; alpha is not looked at.
    enum rn_status (*add)(struct rn_film *film, const uint8_t *pixels, struct rn_error *err);
    // After the last frame of a pass.
    enum rn_status (*end_pass)(struct rn_film *film, struct rn_error *err);
    void (*close)(struct rn_film **film);
};

extern const struct rn_film_module rn_film_module;

#endif
