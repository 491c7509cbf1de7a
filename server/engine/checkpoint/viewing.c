#include "server/engine/checkpoint/viewing.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/math/half.h"
#include "server/engine/checkpoint/blocks.h"
#include "server/engine/checkpoint/state.h"
#include "server/engine/field/occupancy.h"
#include "server/engine/field/voxels.h"
#include "server/engine/scene/device.h"
#include "server/engine/scene/scene.h"

#define HEADER (32 << 10) // bytes, so that a file's size does not depend on what it says
#define MATTER 1e6f       // of an occupied cell: above every threshold

const int rn_viewing_bits[RN_VIEWING_FORMS] = {4, 5, 6, 8, 16, 32};

bool rn_viewing_has_bits(int bits) {
    for (int i = 0; i < RN_VIEWING_FORMS; i++)
        if (rn_viewing_bits[i] == bits) return true;
    return false;
}

// The planes as they are stored, and the cells as bits.
struct stored {
    struct rn_blocks blocks; // of up to 8 bits
    uint16_t *halves;        // of 16
    uint8_t *cells;
    struct rn_tensor list[RN_CHECKPOINT_TENSORS];
    int count;
};

static size_t cell_count(const struct rn_field *field) {
    size_t side = (size_t)field->config.field.occupancy;
    return side * side * side;
}

static void finish(struct stored *s) {
    free(s->blocks.codes);
    free(s->blocks.low);
    free(s->blocks.step);
    free(s->halves);
    free(s->cells);
}

static void list_tensors(const struct rn_field *field, int bits, struct stored *s) {
    const struct rn_field_config *c = &field->config.field;
    const struct rn_parameters *p = &field->parameters;
    const size_t base = (size_t)c->base, channels = (size_t)c->channels,
                 planes = (size_t)rn_grid_count(c);
    size_t side = (base + RN_BLOCK_SIDE - 1) / RN_BLOCK_SIDE;
    const size_t texels[] = {planes, base, base, channels},
                 blocks[] = {planes, side, side, channels};
    size_t codes = s->blocks.count * (size_t)(RN_BLOCK_VALUES / 8 * bits),
           eighth = cell_count(field) / 8;
    struct rn_tensor *list = s->list;
    int *n = &s->count;
    if (bits == 32) rn_checkpoint_add(list, n, "planes", "F32", 4, texels, p->values);
    if (bits == 16) rn_checkpoint_add(list, n, "planes", "F16", 4, texels, s->halves);
    if (bits <= RN_BLOCK_BITS_MAX) {
        rn_checkpoint_add(list, n, "planes", "U8", 1, &codes, s->blocks.codes);
        rn_checkpoint_add(list, n, "planes.low", "F16", 4, blocks, s->blocks.low);
        rn_checkpoint_add(list, n, "planes.step", "F16", 4, blocks, s->blocks.step);
    }
    rn_checkpoint_add_network(list, n, "base", &field->cpu.base_shape, p->values + p->plane_count);
    rn_checkpoint_add_network(list, n, "head", &field->cpu.head_shape,
                              p->values + p->plane_count + p->base_count);
    rn_checkpoint_add_appearances(list, n, field);
    rn_checkpoint_add(list, n, "cells", "U8", 1, &eighth, s->cells);
}

// Room for what is stored, and the list of it; finish() frees it.
static enum rn_status begin(const struct rn_field *field, int bits, struct stored *ret,
                            struct rn_error *err) {
    size_t blocks = rn_blocks_count(&field->config.field);
    *ret = (struct stored){.blocks = {.bits = bits, .count = blocks},
                           .cells = calloc(1, cell_count(field) / 8)};
    bool all = ret->cells;
    if (bits <= RN_BLOCK_BITS_MAX) {
        ret->blocks.codes = malloc(blocks * (size_t)(RN_BLOCK_VALUES / 8 * bits));
        ret->blocks.low = malloc(blocks * sizeof(uint16_t));
        ret->blocks.step = malloc(blocks * sizeof(uint16_t));
        all = all && ret->blocks.codes && ret->blocks.low && ret->blocks.step;
    } else if (bits == 16) {
        ret->halves = malloc(field->parameters.plane_count * sizeof(uint16_t));
        all = all && ret->halves;
    }
    list_tensors(field, bits, ret);
    if (all) return RN_OK;
    finish(ret);
    return rn_error_set(err, RN_ERROR_NO_MEMORY, "planes", "out of memory");
}

size_t rn_viewing_bytes(const struct rn_field *field, int bits) {
    struct stored s = {.blocks = {.bits = bits, .count = rn_blocks_count(&field->config.field)}};
    size_t bytes = sizeof(uint64_t) + HEADER;
    list_tensors(field, bits, &s);
    for (int i = 0; i < s.count; i++)
        bytes += s.list[i].bytes;
    return bytes;
}

// ---- writing --------------------------------------------------------------------------------

static enum rn_status check_range(const struct rn_field *field, struct rn_error *err) {
    for (size_t i = 0; i < field->parameters.plane_count; i++)
        if (!(fabsf(field->parameters.values[i]) <= RN_HALF_MAX))
            return rn_error_set(err, RN_ERROR_LIMIT, "planes",
                                "hold %g, more than a half can (65504); only 32 bits a value do",
                                (double)field->parameters.values[i]);
    return RN_OK;
}

static void pack_cells(const struct rn_field *field, uint8_t *cells) {
    int side = field->config.field.occupancy;
    for (int x = 0; x < side; x++)
        for (int y = 0; y < side; y++)
            for (int z = 0; z < side; z++) {
                size_t at = rn_cell_index(x, y, z, side);
                bool matter =
                    field->coarse.words[rn_brick_word(x, y, z, side)] & rn_brick_bit(x, y);
                cells[at / 8] |= (uint8_t)(matter << at % 8);
            }
}

static void pack_planes(const struct rn_field *field, int bits, struct stored *s) {
    const struct rn_parameters *p = &field->parameters;
    if (bits <= RN_BLOCK_BITS_MAX) rn_blocks_pack(&field->config.field, p->values, &s->blocks);
    for (size_t i = 0; bits == 16 && i < p->plane_count; i++)
        s->halves[i] = rn_half_nearest(p->values[i]);
}

static enum rn_status write_stored(const struct rn_field *field, const struct rn_viewing *viewing,
                                   const struct stored *s, const char *path, struct rn_error *err) {
    char temporary[4096 + 16], sealed[65];
    const struct rn_counters counters = {.progress = {.step = field->steps,
                                                      .train_seconds = field->train_seconds,
                                                      .psnr = field->psnr},
                                         .next_rays = 1};
    char *header = rn_checkpoint_header(field, &counters, viewing, s->list, s->count);
    if (!header) return rn_error_set(err, RN_ERROR_NO_MEMORY, path, "out of memory");
    int error = strlen(header) <= HEADER ? 0 : EOVERFLOW, fd = -1;
    snprintf(temporary, sizeof temporary, "%s.partial", path);
    if (!error && (fd = open(temporary, O_RDWR | O_CREAT | O_TRUNC | O_CLOEXEC, 0644)) < 0)
        error = errno;
    if (!error && !rn_checkpoint_put(fd, header, HEADER, s->list, s->count)) error = errno;
    if (fd >= 0) error = rn_checkpoint_settle(fd, error, temporary, path, sealed);
    free(header);
    return error ? rn_error_from_errno(err, error, path, "write the scene") : RN_OK;
}

enum rn_status rn_viewing_write(struct rn_field *field, const struct rn_viewing *viewing,
                                const char *path, struct rn_error *err) {
    struct stored s;
    enum rn_status status = rn_field_fetch(field, NULL, err);
    if (status == RN_OK && viewing->bits < 32) status = check_range(field, err);
    if (status == RN_OK) status = begin(field, viewing->bits, &s, err);
    if (status != RN_OK) return status;
    pack_planes(field, viewing->bits, &s);
    pack_cells(field, s.cells);
    status = write_stored(field, viewing, &s, path, err);
    finish(&s);
    return status;
}

// ---- reading --------------------------------------------------------------------------------

static bool all_finite(const uint16_t *halves, size_t count) {
    for (size_t i = 0; i < count; i++)
        if (!rn_half_is_finite(halves[i])) return false;
    return true;
}

// false: what was read is not finite.
static bool unpack_planes(struct rn_field *field, int bits, const struct stored *s) {
    const struct rn_parameters *p = &field->parameters;
    if (bits <= RN_BLOCK_BITS_MAX) {
        if (!all_finite(s->blocks.low, s->blocks.count) ||
            !all_finite(s->blocks.step, s->blocks.count))
            return false;
        rn_blocks_unpack(&field->config.field, &s->blocks, p->values);
    } else if (bits == 16) {
        if (!all_finite(s->halves, p->plane_count)) return false;
        for (size_t i = 0; i < p->plane_count; i++)
            p->values[i] = rn_half_to_float(s->halves[i]);
    }
    return true;
}

static void unpack_cells(struct rn_field *field, const uint8_t *cells) {
    field->hull_cells = 0;
    for (size_t i = 0; i < cell_count(field); i++) {
        field->hull[i] = cells[i / 8] >> i % 8 & 1;
        field->occupancy[i] = field->hull[i] ? MATTER : 0;
        field->hull_cells += field->hull[i];
    }
}

enum rn_status rn_viewing_read(const struct rn_checkpoint *c, struct rn_field *field,
                               struct rn_error *err) {
    struct stored s;
    enum rn_status status = begin(field, c->viewing.bits, &s, err);
    if (status != RN_OK) return status;
    status = rn_checkpoint_read_list(c, s.list, s.count, err);
    if (status == RN_OK && !unpack_planes(field, c->viewing.bits, &s))
        status = rn_error_set(err, RN_ERROR_CORRUPT, c->path,
                              "tensor 'planes' holds non-finite numbers");
    if (status == RN_OK) unpack_cells(field, s.cells);
    finish(&s);
    return status;
}
