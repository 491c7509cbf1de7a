#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "server/runner/ingest/poses.h"

#define FRAMES_A_SECOND 2
#define WIDTH "480"
#define MAX_SIDE 4096 // of a scaled frame
#define MAX_FRAMES 1000000
#define MAX_ARRIVED ((size_t)4 * MAX_SIDE * MAX_SIDE) // of frames that are not whole yet
// What a file may be that is called a film. Others, playlists above all, name files of their own.
#define KINDS "-format_whitelist", "mov,matroska,avi,mpegts"
#define EXPRESSION_BYTES (RN_FILM_FRAMES * 20 + 32)

// The film as it arrives, small and grey: PGM pictures one after the other.
struct look {
    const struct rn_poses_order *order;
    uint8_t *bytes; // of a frame and its head
    size_t size, capacity;
    float *sharpness; // of each frame
    size_t count, room;
    double seconds; // of the film, by its head; 0: not said
    const char *film;
    enum rn_status status; // why no more is taken, and `fault`
    struct rn_error fault;
};

static double laplacian(const uint8_t *pixels, int width, int height) {
    double sum = 0;
    for (int y = 1; y + 1 < height; y++)
        for (int x = 1; x + 1 < width; x++) {
            const uint8_t *p = pixels + (size_t)y * (size_t)width + x;
            int value = 4 * p[0] - p[-1] - p[1] - p[-width] - p[width];
            sum += (double)value * value;
        }
    return sum / ((double)width * height);
}

// Makes room for the doubled count; false where there is none.
static bool grow(struct look *look, void **block, size_t count, size_t size) {
    void *grown = realloc(*block, count * size);
    if (grown)
        *block = grown;
    else
        look->status = rn_error_set(&look->fault, RN_ERROR_NO_MEMORY, look->film, "out of memory");
    return grown != NULL;
}

static bool add_frame(struct look *look, const uint8_t *pixels, int width, int height) {
    if (look->count == MAX_FRAMES) {
        look->status = rn_error_set(&look->fault, RN_ERROR_LIMIT, look->film,
                                    "has more than %d frames: cut it into parts", MAX_FRAMES);
        return false;
    }
    if (look->count == look->room) {
        size_t room = look->room ? 2 * look->room : 1024;
        if (!grow(look, (void **)&look->sharpness, room, sizeof *look->sharpness)) return false;
        look->room = room;
    }
    look->sharpness[look->count++] = (float)laplacian(pixels, width, height);
    if (look->count % 16 == 0)
        look->order->stage(look->order->context, "looking through the film", look->count, 0);
    return true;
}

// The whole frames at the front of what has arrived.
static bool take_frames(struct look *look) {
    size_t at = 0;
    for (;;) {
        char head[48];
        int width, height, used = 0;
        size_t left = look->size - at, known = left < sizeof head - 1 ? left : sizeof head - 1;
        memcpy(head, look->bytes + at, known);
        head[known] = '\0';
        if (sscanf(head, "P5 %d %d 255%n", &width, &height, &used) != 2 || !used) break;
        if (width < 3 || height < 3 || width > MAX_SIDE || height > MAX_SIDE) {
            look->status = rn_error_set(&look->fault, RN_ERROR_LIMIT, look->film,
                                        "has frames that are %d x %d pixels once they are " WIDTH
                                        " wide, 3 to %d a side are read: crop them",
                                        width, height, MAX_SIDE);
            return false;
        }
        size_t size = (size_t)used + 1 + (size_t)width * (size_t)height;
        if (left < size) break;
        if (!add_frame(look, look->bytes + at + used + 1, width, height)) return false;
        at += size;
    }
    memmove(look->bytes, look->bytes + at, look->size - at);
    look->size -= at;
    return true;
}

static bool take_bytes(void *context, const void *bytes, size_t size) {
    struct look *look = context;
    if (look->size + size > MAX_ARRIVED) {
        look->status = rn_error_set(&look->fault, RN_ERROR_INVALID, look->film,
                                    "ffmpeg makes no pictures of it: convert it to MP4");
        return false;
    }
    if (look->size + size > look->capacity) {
        size_t capacity = 2 * (look->size + size);
        if (!grow(look, (void **)&look->bytes, capacity, 1)) return false;
        look->capacity = capacity;
    }
    memcpy(look->bytes + look->size, bytes, size);
    look->size += size;
    return take_frames(look);
}

static void read_duration(void *context, const char *line) {
    struct look *look = context;
    int hours, minutes;
    double seconds;
    const char *at = strstr(line, "Duration: ");
    if (at && sscanf(at, "Duration: %d:%d:%lf", &hours, &minutes, &seconds) == 3)
        look->seconds = hours * 3600.0 + minutes * 60.0 + seconds;
}

static bool keep_looking(void *context) {
    struct look *look = context;
    return look->order->keep_going(look->order->context);
}

// The frames to take: of `wanted` equal stretches the sharpest each.
static size_t choose(const struct look *look, size_t wanted, size_t *chosen) {
    if (wanted > look->count) wanted = look->count;
    for (size_t i = 0; i < wanted; i++) {
        size_t begin = i * look->count / wanted, end = (i + 1) * look->count / wanted;
        chosen[i] = begin;
        for (size_t k = begin; k < end; k++)
            if (look->sharpness[k] > look->sharpness[chosen[i]]) chosen[i] = k;
    }
    return wanted;
}

static enum rn_status look_through(struct look *look, const char *film, struct rn_error *err) {
    const char *const argv[] = {"-nostdin",
                                "-hide_banner",
                                KINDS,
                                "-i",
                                film,
                                "-an",
                                "-sn",
                                "-vf",
                                "scale=" WIDTH ":-2,format=gray",
                                "-f",
                                "image2pipe",
                                "-c:v",
                                "pgm",
                                "-",
                                NULL};
    struct rn_program ffmpeg = {.name = "ffmpeg",
                                .package = "ffmpeg",
                                .line = read_duration,
                                .bytes = take_bytes,
                                .keep_going = keep_looking,
                                .context = look};
    struct rn_error fault;
    enum rn_status status = rn_program_run(&ffmpeg, argv, &fault);
    if (status == RN_ERROR_INVALID && look->count == 0)
        return rn_error_set(err, status, film,
                            "ffmpeg %.300s; films are MP4, MOV, MKV, WebM, AVI or MPEG transport "
                            "streams: convert it to MP4",
                            fault.text);
    if (status && err) *err = fault;
    if (status == RN_ERROR_CANCELLED && look->status) {
        if (err) *err = look->fault;
        return look->status;
    }
    if (status == RN_OK && look->count == 0)
        return rn_error_set(err, RN_ERROR_INVALID, film, "has no frame that can be read");
    return status;
}

static enum rn_status write_frames(struct look *look, const char *film, const char *folder,
                                   const size_t *chosen, size_t count, struct rn_error *err) {
    char expression[EXPRESSION_BYTES], pattern[4200];
    size_t used = (size_t)snprintf(expression, sizeof expression, "select='0");
    for (size_t i = 0; i < count; i++)
        used +=
            (size_t)snprintf(expression + used, sizeof expression - used, "+eq(n,%zu)", chosen[i]);
    snprintf(expression + used, sizeof expression - used, "'");
    snprintf(pattern, sizeof pattern, "%s/frame_%%06d.jpg", folder);
    const char *const argv[] = {
        "-nostdin", "-hide_banner", "-loglevel", "error",    KINDS,    "-i", film,
        "-an",      "-sn",          "-vf",       expression, "-vsync", "0",  "-qmin",
        "1",        "-q:v",         "1",         pattern,    NULL};
    struct rn_program ffmpeg = {
        .name = "ffmpeg", .package = "ffmpeg", .keep_going = keep_looking, .context = look};
    look->order->stage(look->order->context, "taking frames of the film", 0, 0);
    return rn_program_run(&ffmpeg, argv, err);
}

enum rn_status rn_film_frames(const struct rn_poses_order *order, const char *film,
                              const char *folder, struct rn_error *err) {
    struct look look = {.order = order, .film = film};
    size_t chosen[RN_FILM_FRAMES], count;
    enum rn_status status = look_through(&look, film, err);
    if (status == RN_OK) {
        double wanted = ceil(look.seconds * FRAMES_A_SECOND);
        if (!(wanted >= 1) || wanted > RN_FILM_FRAMES) wanted = RN_FILM_FRAMES;
        count = choose(&look, (size_t)wanted, chosen);
        status = write_frames(&look, film, folder, chosen, count, err);
        if (status == RN_OK)
            rn_problems_add(order->problems, RN_SEVERITY_INFO, film,
                            "has %zu frames in %.1f s; the sharpest of each of %zu stretches is "
                            "taken",
                            look.count, look.seconds, count);
    }
    free(look.bytes);
    free(look.sharpness);
    return status;
}
