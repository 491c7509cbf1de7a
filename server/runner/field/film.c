#include "server/runner/field/film.h"

#include <dlfcn.h>
#include <errno.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/image/image.h"
#include "server/film/film.h"

// Threads that an encoder made do not survive its code.
#define MODULE_FLAGS (RTLD_NOW | RTLD_LOCAL | RTLD_NODELETE)

// Beside the running program, of one build with it; else where it is installed. `path` holds the
// first of the two.
static const char *find_module(char *path, size_t size) {
    char program[1024];
    const char *given = getenv("RIPNERF_FILM_MODULE");
    if (given) return given;
    ssize_t length = readlink("/proc/self/exe", program, sizeof program - 1);
    program[length > 0 ? length : 0] = '\0';
    char *slash = strrchr(program, '/');
    if (slash) *slash = '\0';
    snprintf(path, size, "%s/film/ripnerf-film.so", program);
    return access(path, R_OK) == 0 ? path : RN_MODULE_FOLDER "/ripnerf-film.so";
}

bool rn_film_is_installed(void) {
    char path[1100];
    struct stat about;
    const char *file = find_module(path, sizeof path);
    return stat(file, &about) == 0 && S_ISREG(about.st_mode) && access(file, R_OK) == 0;
}

static enum rn_status load(const struct rn_film_module **ret_module, struct rn_error *err) {
    char path[1100];
    void *module = dlopen(find_module(path, sizeof path), MODULE_FLAGS);
    const struct rn_film_module *table = module ? dlsym(module, RN_FILM_SYMBOL) : NULL;
    const char *why = table ? NULL : dlerror();
    if (!table)
        return rn_error_set(err, RN_ERROR_UNSUPPORTED, "#/options/film",
                            "films need ripnerf-film.so, which is not installed; `meson compile` "
                            "makes it where FFmpeg's libraries are (libavcodec-dev, "
                            "libavformat-dev, libavutil-dev, libswscale-dev); a folder "
                            "(-o FOLDER) gets frames instead (%s)",
                            why ? why : "no reason given");
    if (table->version != RN_FILM_VERSION)
        return rn_error_set(err, RN_ERROR_UNSUPPORTED, "#/options/film",
                            "the film module is of version %d, not %d; install both from one build",
                            table->version, RN_FILM_VERSION);
    *ret_module = table;
    return RN_OK;
}

enum rn_status rn_film_check(struct rn_error *err) {
    const struct rn_film_module *module;
    return load(&module, err);
}

const char *rn_film_name(int codec) {
    return codec == RN_FILM_GIF ? "film.gif" : codec == RN_FILM_VP9 ? "film.webm" : "film.mp4";
}

static enum rn_status read_frame(const struct rn_film_order *order, size_t i,
                                 struct rn_image *ret_image, struct rn_error *err) {
    char file[PATH_MAX];
    if (snprintf(file, sizeof file, "%s/%05zu.png", order->folder, order->first + i) >= PATH_MAX)
        return rn_error_set(err, RN_ERROR_LIMIT, order->folder, "the path is too long");
    return rn_image_read(file, NULL, ret_image, err);
}

static enum rn_status add_frames(const struct rn_film_order *order,
                                 const struct rn_film_module *module, struct rn_film *film,
                                 const struct rn_image *size, struct rn_error *err) {
    for (size_t i = 0; i < order->count; i++) {
        struct rn_image image;
        if (!order->keep_going(order->context))
            return rn_error_set(err, RN_ERROR_CANCELLED, "", "cancelled; the frames are kept");
        enum rn_status status = read_frame(order, i, &image, err);
        if (status) return status;
        if (image.width != size->width || image.height != size->height)
            status = rn_error_set(err, RN_ERROR_CORRUPT, "film", "frame %zu has another size", i);
        else
            status = module->add(film, image.pixels, err);
        rn_image_finish(&image);
        if (status) return status;
    }
    return module->end_pass(film, err);
}

static enum rn_status write_film(const struct rn_film_order *order,
                                 const struct rn_film_module *module, const char *file,
                                 struct rn_error *err) {
    struct rn_image image;
    struct rn_film *film = NULL;
    int passes = 1;
    enum rn_status status = read_frame(order, 0, &image, err);
    if (status) return status;
    struct rn_film_spec spec = {.file = file,
                                .codec = (enum rn_film_codec)order->codec,
                                .width = image.width,
                                .height = image.height,
                                .fps = order->fps,
                                .quality = order->quality};
    status = module->open(&spec, &film, &passes, err);
    for (int pass = 0; pass < passes && !status; pass++)
        status = add_frames(order, module, film, &image, err);
    if (film) module->close(&film);
    rn_image_finish(&image);
    return status;
}

enum rn_status rn_film_make(const struct rn_film_order *order, struct rn_error *err) {
    const struct rn_film_module *module = NULL;
    char file[PATH_MAX], unfinished[PATH_MAX];
    const char *name = rn_film_name(order->codec);
    if (snprintf(file, sizeof file, "%s/%s", order->folder, name) >= PATH_MAX ||
        snprintf(unfinished, sizeof unfinished, "%s/.%s", order->folder, name) >= PATH_MAX)
        return rn_error_set(err, RN_ERROR_LIMIT, order->folder, "the path is too long");
    enum rn_status status = load(&module, err);
    if (!status) status = write_film(order, module, unfinished, err);
    if (!status && rename(unfinished, file) < 0)
        status = rn_error_from_errno(err, errno, file, "keep the film");
    if (status) unlink(unfinished);
    return status;
}
