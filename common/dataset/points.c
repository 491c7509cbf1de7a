#include "common/dataset/points.h"

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/file.h"
#include "common/dataset/output.h"

#define MAX_BYTES (sizeof(struct head) + (size_t)RN_POINTS_MAX * 32 + (size_t)RN_SIGHTINGS_MAX * 16)

struct head {
    char magic[8];
    uint64_t points, sightings;
};
static const char magic[8] = "RNPOINT1";

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "structs are written as they lie");
_Static_assert(sizeof(struct rn_point) == 32 && sizeof(struct rn_sighting) == 16,
               "the file's records are the structs");

enum rn_status rn_points_write(const struct rn_points *points, const char *path,
                               struct rn_error *err) {
    struct head head = {.points = points->count, .sightings = points->sighting_count};
    size_t items = points->count * sizeof *points->items;
    size_t sightings = points->sighting_count * sizeof *points->sightings;
    memcpy(head.magic, magic, sizeof magic);
    uint8_t *bytes = calloc(1, sizeof head + items + sightings);
    if (!bytes) return rn_error_set(err, RN_ERROR_NO_MEMORY, path, "out of memory");
    memcpy(bytes, &head, sizeof head);
    if (items) memcpy(bytes + sizeof head, points->items, items);
    if (sightings) memcpy(bytes + sizeof head + items, points->sightings, sightings);
    enum rn_status status = rn_output_file(path, bytes, sizeof head + items + sightings, err);
    free(bytes);
    return status;
}

bool rn_points_take(const double position[3]) {
    for (int i = 0; i < 3; i++)
        if (!(fabs(position[i]) <= RN_CAMERA_MAX_AWAY)) return false;
    return true;
}

static bool sound(const struct rn_points *points) {
    for (size_t i = 0; i < points->count; i++)
        if (!rn_points_take(points->items[i].position)) return false;
    for (size_t i = 0; i < points->sighting_count; i++) {
        const struct rn_sighting *sighting = &points->sightings[i];
        if (sighting->point >= points->count || !isfinite(sighting->x) || !isfinite(sighting->y))
            return false;
    }
    return true;
}

static enum rn_status take(const uint8_t *bytes, size_t size, const char *path,
                           struct rn_points *points, struct rn_error *err) {
    struct head head;
    if (size < sizeof head || memcmp(bytes, magic, sizeof magic) != 0)
        return rn_error_set(err, RN_ERROR_INVALID, path, "holds no sparse points of a dataset");
    memcpy(&head, bytes, sizeof head);
    if (head.points > RN_POINTS_MAX || head.sightings > RN_SIGHTINGS_MAX ||
        size != sizeof head + head.points * 32 + head.sightings * 16)
        return rn_error_set(err, RN_ERROR_INVALID, path,
                            "is of another size than its %llu points and %llu sightings need",
                            (unsigned long long)head.points, (unsigned long long)head.sightings);
    points->items = malloc(head.points * 32 + 1);
    points->sightings = malloc(head.sightings * 16 + 1);
    if (!points->items || !points->sightings)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, path, "out of memory");
    points->count = (size_t)head.points;
    points->sighting_count = (size_t)head.sightings;
    memcpy(points->items, bytes + sizeof head, points->count * 32);
    memcpy(points->sightings, bytes + sizeof head + points->count * 32,
           points->sighting_count * 16);
    if (sound(points)) return RN_OK;
    return rn_error_set(err, RN_ERROR_INVALID, path,
                        "has a point that is not finite, or a sighting of no point");
}

enum rn_status rn_points_read(const char *path, struct rn_points *ret_points,
                              struct rn_error *err) {
    uint8_t *bytes;
    size_t size;
    struct rn_points points = {0};
    enum rn_status status = rn_file_read(path, MAX_BYTES, &bytes, &size, err);
    if (status) return status;
    status = take(bytes, size, path, &points, err);
    free(bytes);
    if (status == RN_OK)
        *ret_points = points;
    else
        rn_points_finish(&points);
    return status;
}

void rn_points_cut(struct rn_points *points, size_t count) {
    if (count < points->count) points->count = count;
    points->sighting_count = 0;
    points->found = false;
}

void rn_points_finish(struct rn_points *points) {
    free(points->items);
    free(points->sightings);
    *points = (struct rn_points){0};
}
