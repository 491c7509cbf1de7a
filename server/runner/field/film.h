// Frames of a job into a film, by the module that knows how.
#ifndef RN_SERVER_RUNNER_FIELD_FILM_H
#define RN_SERVER_RUNNER_FIELD_FILM_H

#include <stdbool.h>
#include <stddef.h>

#include "common/base/status.h"

// The frames FIRST.png, FIRST + 1 .png, ... of `folder`, five digits each, all of one size.
struct rn_film_order {
    const char *folder; // the film goes here too, as film.mp4, film.webm or film.gif
    size_t first, count;
    int codec; // enum rn_film_codec
    double fps;
    int quality;                       // 0 .. 100
    bool (*keep_going)(void *context); // asked before each frame
    void *context;
};

// Writes the film beside the frames under another name, then renames it: it is there whole or not
// at all. RN_ERROR_UNSUPPORTED: the module or the encoder is not installed; RN_ERROR_CANCELLED:
// keep_going said so.
enum rn_status rn_film_make(const struct rn_film_order *order, struct rn_error *err) RN_MUST_CHECK;
// Whether the module is there, which is not loaded for that.
bool rn_film_is_installed(void);
// Whether films can be made here at all: RN_ERROR_UNSUPPORTED says what is missing.
enum rn_status rn_film_check(struct rn_error *err) RN_MUST_CHECK;
// "film.mp4" of a codec.
const char *rn_film_name(int codec);

#endif
