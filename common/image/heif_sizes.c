// How large the pictures of a HEIC or AVIF file are by what they are made of, which need not be
// what the file says first: a library makes room for a grid or a coded picture by its
// own data.
#include "common/image/heif_sizes.h"

#include <limits.h>
#include <stdlib.h>
#include <string.h>

#include "common/image/codec.h"

#define GRID RN_BOX('g', 'r', 'i', 'd')
#define OVERLAY RN_BOX('i', 'o', 'v', 'l')
#define IDENTITY RN_BOX('i', 'd', 'e', 'n')
#define HEVC RN_BOX('h', 'v', 'c', '1')
#define AV1 RN_BOX('a', 'v', '0', '1')
#define MOST_PADDING 128 // of a coded picture: whole blocks of it, which are 64 pixels at most
#define MOST_SHARED 16   // how often the file's bytes may be those of parts

// Derived and coded pictures alone.
struct item {
    uint32_t id, type;
    struct rn_extent said; // by its property; 0 x 0: none
    bool looked_at;
};

// A picture's size as it is said (ispe), or as its decoder is told (hvcC); 0 x 0: something else.
struct property {
    uint32_t type;
    struct rn_extent size;
};

struct look {
    struct rn_span file, data;   // `data`: the box of items that lie in the header
    struct item *items;          // owned; sorted by id and type, each once
    struct property *properties; // owned
    size_t item_count, property_count;
    uint64_t left; // bytes of parts that are still looked at
    const struct rn_image_limits *limits;
    const char *where;
    struct rn_error *err;
};

static enum rn_status damaged(const struct look *look, const char *what) {
    return rn_error_set(look->err, RN_ERROR_INVALID, look->where,
                        "the HEIC or AVIF file is damaged (%s): copy or export it again", what);
}

// libheif 1.15 ends the process where what such a picture is made of is no picture of the file.
static enum rn_status not_read(const struct look *look) {
    return rn_error_set(look->err, RN_ERROR_UNSUPPORTED, look->where,
                        "the HEIC or AVIF file has a picture that is laid over others, or is "
                        "derived from one; such are not read: convert it to JPEG");
}

static enum rn_status no_memory(const struct look *look) {
    return rn_error_set(look->err, RN_ERROR_NO_MEMORY, look->where,
                        "no memory to read the HEIC or AVIF");
}

static enum rn_status check_size(const struct look *look, struct rn_extent size) {
    const struct rn_image_limits *most = look->limits;
    if (size.width <= (uint32_t)most->max_width && size.height <= (uint32_t)most->max_height &&
        (uint64_t)size.width * size.height <= most->max_pixels)
        return RN_OK;
    return rn_error_set(look->err, RN_ERROR_LIMIT, look->where,
                        "the HEIC or AVIF file is over a limit (%d x %d pixels, %zu in all): a "
                        "picture in it is %u x %u: scale it down, or convert it to JPEG",
                        most->max_width, most->max_height, most->max_pixels, size.width,
                        size.height);
}

// A part of `item` is so large, but for `padding`.
static enum rn_status check_part(const struct look *look, const struct item *item,
                                 struct rn_extent size, uint32_t padding) {
    struct rn_extent said = item->said;
    enum rn_status status = check_size(look, size);
    if (status || (said.width == 0 && said.height == 0)) return status;
    if (size.width <= (uint64_t)said.width + padding &&
        size.height <= (uint64_t)said.height + padding)
        return RN_OK;
    return rn_error_set(look->err, RN_ERROR_INVALID, look->where,
                        "the HEIC or AVIF file's picture is of another size (%u x %u) than its "
                        "header says (%u x %u): export it again",
                        size.width, size.height, said.width, said.height);
}

// ---- items and their properties ----------------------------------------------------------------

static int by_id(const void *a, const void *b) {
    const struct item *left = a, *right = b;
    if (left->id != right->id) return left->id > right->id ? 1 : -1;
    return (left->type > right->type) - (left->type < right->type);
}

// The first of those of an id.
static struct item *first_of(const struct look *look, uint64_t id) {
    size_t low = 0, high = look->item_count;
    while (low < high) {
        size_t middle = (low + high) / 2;
        if (look->items[middle].id < id)
            low = middle + 1;
        else
            high = middle;
    }
    return look->items + low;
}

static bool is_of(const struct look *look, const struct item *item, uint64_t id) {
    return item < look->items + look->item_count && item->id == id;
}

// A box of items (ISO/IEC 14496-12, 8.11.6).
static enum rn_status take_items(struct look *look, struct rn_span box) {
    uint64_t version, count, id, protection, kind;
    uint32_t type;
    struct rn_span entry;
    size_t most = (size_t)(box.end - box.at) / 8, used = 0;
    if (look->items || !rn_span_take(&box, 4, &version) ||
        !rn_span_take(&box, version >> 24 ? 4 : 2, &count))
        return RN_OK;
    look->items = malloc((most + 1) * sizeof *look->items);
    if (!look->items) return no_memory(look);
    while (rn_box_take(&box, &type, &entry)) {
        if (type != RN_BOX('i', 'n', 'f', 'e') || !rn_span_take(&entry, 4, &version) ||
            version >> 24 < 2 || !rn_span_take(&entry, version >> 24 == 2 ? 2 : 4, &id) ||
            !rn_span_take(&entry, 2, &protection) || !rn_span_take(&entry, 4, &kind))
            continue;
        if (kind == OVERLAY || kind == IDENTITY) return not_read(look);
        if (kind == GRID || kind == HEVC || kind == AV1)
            look->items[used++] = (struct item){.id = (uint32_t)id, .type = (uint32_t)kind};
    }
    qsort(look->items, used, sizeof *look->items, by_id);
    for (size_t i = 0; i < used; i++)
        if (i == 0 || by_id(&look->items[i], &look->items[i - 1]) != 0)
            look->items[look->item_count++] = look->items[i];
    return RN_OK;
}

static void grow(struct rn_extent *size, struct rn_extent by) {
    if (by.width > size->width) size->width = by.width;
    if (by.height > size->height) size->height = by.height;
}

// What a decoder is told beforehand (ISO/IEC 14496-15, 8.3.3.1): lists of units.
static struct rn_extent size_of_configuration(struct rn_span box) {
    struct rn_extent most = {0, 0}, size;
    uint64_t lists, kind, units, bytes;
    if (box.end - box.at < 22) return most;
    box.at += 22;
    if (!rn_span_take(&box, 1, &lists)) return most;
    while (lists-- > 0 && rn_span_take(&box, 1, &kind) && rn_span_take(&box, 2, &units))
        while (units-- > 0 && rn_span_take(&box, 2, &bytes) &&
               (uint64_t)(box.end - box.at) >= bytes) {
            if (rn_hevc_size((struct rn_span){box.at, box.at + bytes}, &size)) grow(&most, size);
            box.at += bytes;
        }
    return most;
}

static struct property read_property(uint32_t type, struct rn_span box) {
    struct property property = {.type = type};
    uint64_t version, width, height;
    if (type == RN_BOX('h', 'v', 'c', 'C')) property.size = size_of_configuration(box);
    if (type == RN_BOX('i', 's', 'p', 'e') && rn_span_take(&box, 4, &version) &&
        rn_span_take(&box, 4, &width) && rn_span_take(&box, 4, &height))
        property.size = (struct rn_extent){(uint32_t)width, (uint32_t)height};
    return property;
}

static enum rn_status take_properties(struct look *look, struct rn_span box) {
    struct rn_span body;
    uint32_t type;
    if (look->properties) return RN_OK;
    look->properties = malloc(((size_t)(box.end - box.at) / 8 + 1) * sizeof *look->properties);
    if (!look->properties) return no_memory(look);
    while (rn_box_take(&box, &type, &body))
        look->properties[look->property_count++] = read_property(type, body);
    return RN_OK;
}

// The properties of one item: `wide` when their numbers have two bytes.
static enum rn_status take_own(struct look *look, struct rn_span *box, uint64_t id, bool wide) {
    enum rn_status status = RN_OK;
    uint64_t count, number;
    struct rn_extent coded = {0, 0}, said = {0, 0};
    if (!rn_span_take(box, 1, &count)) return RN_OK;
    while (count-- > 0 && rn_span_take(box, wide ? 2 : 1, &number)) {
        size_t at = number & (wide ? 0x7fff : 0x7f);
        if (at == 0 || at > look->property_count) continue;
        const struct property *property = &look->properties[at - 1];
        grow(property->type == RN_BOX('h', 'v', 'c', 'C') ? &coded : &said, property->size);
    }
    for (struct item *item = first_of(look, id); !status && is_of(look, item, id); item++) {
        grow(&item->said, said);
        if (item->type == HEVC) status = check_part(look, item, coded, MOST_PADDING);
    }
    return status;
}

// Which item has which (ISO/IEC 23008-12, 9.3).
static enum rn_status take_associations(struct look *look, struct rn_span box) {
    enum rn_status status = RN_OK;
    uint64_t version, count, id;
    if (!rn_span_take(&box, 4, &version) || !rn_span_take(&box, 4, &count)) return RN_OK;
    while (!status && count-- > 0 && rn_span_take(&box, version >> 24 ? 4 : 2, &id))
        status = take_own(look, &box, id, version & 1);
    return status;
}

static enum rn_status take_each(struct look *look, struct rn_span box, uint32_t wanted,
                                enum rn_status (*take)(struct look *look, struct rn_span box)) {
    enum rn_status status = RN_OK;
    struct rn_span body;
    uint32_t type;
    while (!status && rn_box_take(&box, &type, &body))
        if (type == wanted) status = take(look, body);
    return status;
}

// ---- their data --------------------------------------------------------------------------------

static enum rn_status check_grid(const struct look *look, const struct item *item,
                                 struct rn_span data) {
    uint64_t version, flags, skipped, width, height;
    if (!rn_span_take(&data, 1, &version) || !rn_span_take(&data, 1, &flags) ||
        !rn_span_take(&data, 2, &skipped) || !rn_span_take(&data, flags & 1 ? 4 : 2, &width) ||
        !rn_span_take(&data, flags & 1 ? 4 : 2, &height))
        return RN_OK;
    struct rn_extent size = {(uint32_t)width, (uint32_t)height};
    return check_part(look, item, size, 0);
}

// The units of a coded picture may have its size, too.
static enum rn_status check_units(const struct look *look, const struct item *item,
                                  struct rn_span data) {
    enum rn_status status = RN_OK;
    uint64_t bytes;
    while (!status && rn_span_take(&data, 4, &bytes)) {
        struct rn_extent size;
        if (bytes > (uint64_t)(data.end - data.at)) bytes = (uint64_t)(data.end - data.at);
        if (rn_hevc_size((struct rn_span){data.at, data.at + bytes}, &size))
            status = check_part(look, item, size, MOST_PADDING);
        data.at += bytes;
    }
    return status;
}

static enum rn_status check_data(struct look *look, uint64_t id, struct rn_span data) {
    enum rn_status status = RN_OK;
    for (struct item *item = first_of(look, id); !status && is_of(look, item, id); item++) {
        if (item->looked_at) continue; // of an item that is twice there the first counts
        item->looked_at = true;
        uint64_t bytes = (uint64_t)(data.end - data.at);
        if (bytes > look->left) return damaged(look, "many of its pictures are the same bytes");
        look->left -= bytes;
        if (item->type == HEVC)
            status = check_units(look, item, data);
        else if (item->type == AV1)
            status = check_part(look, item, rn_av1_size(data), MOST_PADDING);
        else
            status = check_grid(look, item, data);
    }
    return status;
}

// One entry of the table of places: where its bytes begin, and the widths of its numbers.
struct place {
    struct rn_span from;
    uint64_t base;
    int offset_width, length_width, index_width;
};

// The next piece; false where it is not in the file.
static bool take_piece(struct rn_span *box, const struct place *place, struct rn_span *ret_piece) {
    uint64_t index, offset, length, size = (uint64_t)(place->from.end - place->from.at);
    if (!rn_span_take(box, place->index_width, &index) ||
        !rn_span_take(box, place->offset_width, &offset) ||
        !rn_span_take(box, place->length_width, &length))
        return false;
    offset += place->base;
    if (offset < place->base || offset > size || length > size - offset) return false;
    *ret_piece = (struct rn_span){place->from.at + offset, place->from.at + offset + length};
    return true;
}

// An item of several pieces is put together first, as a library does: no more than the file has.
static enum rn_status check_pieces(struct look *look, uint64_t id, struct rn_span *box,
                                   const struct place *place, uint64_t count) {
    size_t most = (size_t)(look->file.end - look->file.at), used = 0;
    enum rn_status status = RN_OK;
    struct rn_span piece;
    bool here = true;
    if (count == 1) return take_piece(box, place, &piece) ? check_data(look, id, piece) : RN_OK;
    bool wanted = is_of(look, first_of(look, id), id) && !first_of(look, id)->looked_at;
    uint8_t *whole = wanted && count ? malloc(most + 1) : NULL;
    if (wanted && count && !whole) return no_memory(look);
    while (!status && count-- > 0) {
        here = take_piece(box, place, &piece) && here;
        size_t size = here ? (size_t)(piece.end - piece.at) : 0;
        if (!whole || !here) continue;
        if (size > most - used)
            status = damaged(look, "a picture in it is longer than the file");
        else
            memcpy(whole + used, piece.at, size);
        used += size;
    }
    if (!status && whole && here)
        status = check_data(look, id, (struct rn_span){whole, whole + used});
    free(whole);
    return status;
}

static int width_of(unsigned bytes) {
    return bytes == 4 || bytes == 8 ? (int)bytes : 0;
}

// The table of places (ISO/IEC 14496-12, 8.11.3).
static enum rn_status take_places(struct look *look, struct rn_span box) {
    enum rn_status status = RN_OK;
    uint64_t version, widths, count, id, way = 0, file, pieces;
    if (!rn_span_take(&box, 4, &version) || !rn_span_take(&box, 2, &widths)) return RN_OK;
    version >>= 24;
    struct place place = {.offset_width = width_of(widths >> 12 & 15),
                          .length_width = width_of(widths >> 8 & 15),
                          .index_width = version ? width_of(widths & 15) : 0};
    int base_width = width_of(widths >> 4 & 15), number = version < 2 ? 2 : 4;
    if (!rn_span_take(&box, number, &count)) return RN_OK;
    while (!status && count-- > 0 && rn_span_take(&box, number, &id) &&
           rn_span_take(&box, version ? 2 : 0, &way) && rn_span_take(&box, 2, &file) &&
           rn_span_take(&box, base_width, &place.base) && rn_span_take(&box, 2, &pieces)) {
        place.from = way & 15 ? look->data : look->file;
        status = check_pieces(look, id, &box, &place, pieces);
    }
    return status;
}

static enum rn_status look_at_properties(struct look *look, struct rn_span box) {
    enum rn_status status = take_each(look, box, RN_BOX('i', 'p', 'c', 'o'), take_properties);
    if (!status) status = take_each(look, box, RN_BOX('i', 'p', 'm', 'a'), take_associations);
    return status;
}

static enum rn_status keep_data(struct look *look, struct rn_span box) {
    if (!look->data.at) look->data = box;
    return RN_OK;
}

static enum rn_status look_at_header(struct look *look, struct rn_span meta) {
    uint64_t version;
    if (!rn_span_take(&meta, 4, &version)) return RN_OK;
    enum rn_status status = take_each(look, meta, RN_BOX('i', 'i', 'n', 'f'), take_items);
    if (!status) status = take_each(look, meta, RN_BOX('i', 'd', 'a', 't'), keep_data);
    if (!status && look->items)
        status = take_each(look, meta, RN_BOX('i', 'p', 'r', 'p'), look_at_properties);
    if (!status && look->items)
        status = take_each(look, meta, RN_BOX('i', 'l', 'o', 'c'), take_places);
    free(look->items);
    free(look->properties);
    look->items = NULL;
    look->properties = NULL;
    look->item_count = look->property_count = 0;
    look->data = (struct rn_span){NULL, NULL};
    return status;
}

enum rn_status rn_heif_check_sizes(const uint8_t *bytes, size_t size_bytes,
                                   const struct rn_image_limits *limits, const char *where,
                                   struct rn_error *err) {
    struct look look = {.file = {bytes, bytes + size_bytes},
                        .left = MOST_SHARED * (uint64_t)size_bytes,
                        .limits = limits,
                        .where = where,
                        .err = err};
    return take_each(&look, look.file, RN_BOX('m', 'e', 't', 'a'), look_at_header);
}
