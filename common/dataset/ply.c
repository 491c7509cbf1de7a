#include "common/dataset/ply.h"

#include <errno.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "common/dataset/points.h"

#define PROPERTIES 64
#define HEADER_LINES 1000

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "numbers are taken as they lie in files");

enum type { INT8, UINT8, INT16, UINT16, INT32, UINT32, FLOAT32, FLOAT64, TYPES };
static const struct {
    const char *names[2];
    size_t size;
} types[TYPES] = {{{"char", "int8"}, 1},     {{"uchar", "uint8"}, 1},   {{"short", "int16"}, 2},
                  {{"ushort", "uint16"}, 2}, {{"int", "int32"}, 4},     {{"uint", "uint32"}, 4},
                  {{"float", "float32"}, 4}, {{"double", "float64"}, 8}};

// What is wanted of a vertex, by the names of its properties.
enum { X, Y, Z, RED, GREEN, BLUE, WANTED };
static const char *const wanted[WANTED] = {"x", "y", "z", "red", "green", "blue"};

struct ply {
    const char *path;
    FILE *file;
    char *line;
    size_t capacity;
    uint64_t number; // of the header's line
    uint64_t size;   // bytes of the file
    bool text, other_element;
    uint64_t vertices;
    size_t property_count;
    enum type property_types[PROPERTIES];
    int meanings[PROPERTIES]; // of `wanted`, or -1
    bool has[WANTED];
};

static enum rn_status bad_line(const struct ply *ply, enum rn_status status, const char *what,
                               struct rn_error *err) {
    char where[256];
    snprintf(where, sizeof where, "%.220s:%" PRIu64, ply->path, ply->number);
    return rn_error_set(err, status, where, "%s", what);
}

static enum rn_status bad_vertex(const struct ply *ply, uint64_t index, const char *what,
                                 struct rn_error *err) {
    char where[256];
    snprintf(where, sizeof where, "%.180s, vertex %" PRIu64 " of %" PRIu64, ply->path, index + 1,
             ply->vertices);
    return rn_error_set(err, RN_ERROR_INVALID, where, "%s", what);
}

// ---- the header ----

static enum rn_status take_property(struct ply *ply, const char *type, const char *name,
                                    struct rn_error *err) {
    int known = 0, meaning = WANTED - 1;
    while (known < TYPES && strcmp(type, types[known].names[0]) != 0 &&
           strcmp(type, types[known].names[1]) != 0)
        known++;
    if (known == TYPES)
        return bad_line(ply, RN_ERROR_UNSUPPORTED, "has a property of a type that is not read",
                        err);
    if (ply->property_count == PROPERTIES)
        return bad_line(ply, RN_ERROR_LIMIT, "has more properties of a vertex than 64", err);
    while (meaning >= 0 && strcmp(name, wanted[meaning]) != 0)
        meaning--;
    if (meaning >= 0) ply->has[meaning] = true;
    ply->property_types[ply->property_count] = (enum type)known;
    ply->meanings[ply->property_count++] = meaning;
    return RN_OK;
}

static enum rn_status take_line(struct ply *ply, bool *ret_end, struct rn_error *err) {
    char first[32] = "", second[32] = "", third[32] = "";
    (void)sscanf(ply->line, "%31s %31s %31s", first, second, third);
    *ret_end = strcmp(first, "end_header") == 0;
    if (strcmp(first, "format") == 0) {
        ply->text = strcmp(second, "ascii") == 0;
        return ply->text || strcmp(second, "binary_little_endian") == 0
                   ? RN_OK
                   : bad_line(ply, RN_ERROR_UNSUPPORTED,
                              "has a format that is not read: save it as ascii or as "
                              "binary_little_endian",
                              err);
    }
    if (strcmp(first, "element") == 0) {
        bool vertex = strcmp(second, "vertex") == 0;
        if (!vertex && !ply->property_count)
            return bad_line(ply, RN_ERROR_UNSUPPORTED, "has something else before its vertices",
                            err);
        ply->other_element = !vertex;
        return !vertex || sscanf(third, "%" SCNu64, &ply->vertices) == 1
                   ? RN_OK
                   : bad_line(ply, RN_ERROR_INVALID, "does not say how many vertices there are",
                              err);
    }
    if (strcmp(first, "property") == 0 && !ply->other_element)
        return take_property(ply, second, third, err);
    return RN_OK;
}

static enum rn_status read_header(struct ply *ply, struct rn_error *err) {
    bool end = false;
    enum rn_status status = RN_OK;
    while (!end && status == RN_OK) {
        if (ply->number == HEADER_LINES || getline(&ply->line, &ply->capacity, ply->file) < 0)
            return bad_line(ply, RN_ERROR_INVALID,
                            "the header does not end: it is cut, or this is no PLY file", err);
        if (++ply->number == 1 && strncmp(ply->line, "ply", 3) != 0)
            return bad_line(ply, RN_ERROR_INVALID, "is no PLY file", err);
        status = take_line(ply, &end, err);
    }
    if (status == RN_OK && !(ply->has[X] && ply->has[Y] && ply->has[Z]))
        return bad_line(ply, RN_ERROR_INVALID, "the header names no vertices with x, y and z", err);
    return status;
}

// ---- vertices ----

static double number(enum type type, const uint8_t *bytes) {
    union {
        int8_t i8;
        uint8_t u8;
        int16_t i16;
        uint16_t u16;
        int32_t i32;
        uint32_t u32;
        float f32;
        double f64;
    } value;
    memcpy(&value, bytes, types[type].size);
    switch (type) {
    case INT8:
        return value.i8;
    case UINT8:
        return value.u8;
    case INT16:
        return value.i16;
    case UINT16:
        return value.u16;
    case INT32:
        return value.i32;
    case UINT32:
        return value.u32;
    case FLOAT32:
        return (double)value.f32;
    default:
        return value.f64;
    }
}

static size_t vertex_bytes(const struct ply *ply) {
    size_t size = 0;
    for (size_t i = 0; i < ply->property_count; i++)
        size += types[ply->property_types[i]].size;
    return size;
}

static bool read_binary(struct ply *ply, double values[WANTED]) {
    uint8_t bytes[PROPERTIES * 8];
    size_t size = vertex_bytes(ply), at = 0;
    if (fread(bytes, 1, size, ply->file) != size) return false;
    for (size_t i = 0; i < ply->property_count; i++) {
        if (ply->meanings[i] >= 0)
            values[ply->meanings[i]] = number(ply->property_types[i], bytes + at);
        at += types[ply->property_types[i]].size;
    }
    return true;
}

static bool read_text(struct ply *ply, double values[WANTED]) {
    ssize_t size = getline(&ply->line, &ply->capacity, ply->file);
    if (size <= 0 || ply->line[size - 1] != '\n') return false;
    char *at = ply->line, *end;
    for (size_t i = 0; i < ply->property_count; i++, at = end) {
        double value = strtod(at, &end);
        if (end == at) return false;
        if (ply->meanings[i] >= 0) values[ply->meanings[i]] = value;
    }
    return true;
}

static uint8_t channel(double value) {
    return value >= 0 && value <= 255 ? (uint8_t)value : 0;
}

static void add_vertex(const struct ply *ply, const double values[WANTED],
                       struct rn_points *points) {
    if (!rn_points_take(values + X)) return;
    struct rn_point *point = &points->items[points->count++];
    *point = (struct rn_point){.position = {values[X], values[Y], values[Z]}, .error = -1};
    for (int i = 0; i < 3; i++)
        point->colour[i] = ply->has[RED + i] ? channel(values[RED + i]) : 128;
}

static enum rn_status read_vertices(struct ply *ply, struct rn_points *points,
                                    struct rn_error *err) {
    size_t least = ply->text ? 2 * ply->property_count : vertex_bytes(ply);
    uint64_t room = (ply->size - (uint64_t)ftello(ply->file)) / least;
    if (ply->vertices > room)
        return rn_error_set(err, RN_ERROR_INVALID, ply->path,
                            "says that it has %" PRIu64 " vertices, but has room for %" PRIu64
                            " at most: copy it again",
                            ply->vertices, room);
    uint64_t stride = 1 + ply->vertices / RN_POINTS_MAX;
    points->items = malloc((size_t)(ply->vertices / stride + 1) * sizeof *points->items);
    if (!points->items) return rn_error_set(err, RN_ERROR_NO_MEMORY, ply->path, "out of memory");
    for (uint64_t i = 0; i < ply->vertices; i++) {
        double values[WANTED];
        if (!(ply->text ? read_text(ply, values) : read_binary(ply, values)))
            return bad_vertex(ply, i, "is not whole: copy the file again", err);
        if (i % stride == 0) add_vertex(ply, values, points);
    }
    return RN_OK;
}

enum rn_status rn_ply_read(const char *path, struct rn_points *points, struct rn_error *err) {
    struct stat about;
    struct ply ply = {.path = path, .file = fopen(path, "rbe")};
    if (!ply.file) return rn_error_from_errno(err, errno, path, "open");
    enum rn_status status = RN_OK;
    if (fstat(fileno(ply.file), &about) != 0 || !S_ISREG(about.st_mode))
        status = rn_error_set(err, RN_ERROR_INVALID, path, "is no regular file");
    ply.size = status ? 0 : (uint64_t)about.st_size;
    if (status == RN_OK) status = read_header(&ply, err);
    if (status == RN_OK) status = read_vertices(&ply, points, err);
    fclose(ply.file);
    free(ply.line);
    if (status) {
        free(points->items);
        points->items = NULL;
        points->count = 0;
    }
    return status;
}
