// What the pictures of a HEIC or AVIF file are made of, looked at before a library follows it.
#include <stdlib.h>

#include "common/image/boxes.h"
#include "common/image/codec.h"

#define MAX_DEPTH 8     // of parts within parts; a phone's photograph has 2
#define MAX_PARTS 65536 // of one picture: the rows and columns of a grid are a byte each
#define OPEN UINT32_MAX

// Item `of` cannot be decoded without item `is`. In the first of those of an item: how many items
// are decoded for it (0: not known yet; OPEN: being counted) and how deep they lie.
struct part {
    uint32_t of, is;
    uint32_t decoded;
    int depth;
};

// Sorted by `of` once all are there.
struct parts {
    struct part *list; // owned
    size_t count, capacity;
};

enum verdict { SOUND, NO_MEMORY, OF_ITSELF, TOO_DEEP, TOO_MANY };

static enum verdict add_part(struct parts *parts, uint32_t of, uint32_t is) {
    if (parts->count == MAX_PARTS) return TOO_MANY;
    if (parts->count == parts->capacity) {
        size_t capacity = parts->capacity ? 2 * parts->capacity : 256;
        struct part *grown = realloc(parts->list, capacity * sizeof *grown);
        if (!grown) return NO_MEMORY;
        parts->list = grown;
        parts->capacity = capacity;
    }
    parts->list[parts->count++] = (struct part){.of = of, .is = is};
    return SOUND;
}

// A box of references (ISO/IEC 14496-12, 8.11.12): a derived picture names its sources (dimg), an
// alpha channel or the like the picture that it belongs to (auxl).
static enum verdict take_references(struct rn_span box, struct parts *parts) {
    enum verdict verdict = SOUND;
    uint64_t version, from, to, count, size;
    uint32_t type;
    if (!rn_span_take(&box, 4, &version)) return SOUND;
    int width = version >> 24 == 0 ? 2 : 4;
    while (!verdict && rn_box_take_header(&box, &size, &type) && rn_span_take(&box, width, &from) &&
           rn_span_take(&box, 2, &count))
        for (; !verdict && count > 0 && rn_span_take(&box, width, &to); count--)
            if (type == RN_BOX('d', 'i', 'm', 'g'))
                verdict = add_part(parts, (uint32_t)from, (uint32_t)to);
            else if (type == RN_BOX('a', 'u', 'x', 'l'))
                verdict = add_part(parts, (uint32_t)to, (uint32_t)from);
    return verdict;
}

static enum verdict take_file(struct rn_span file, struct parts *parts) {
    enum verdict verdict = SOUND;
    struct rn_span meta, box;
    uint64_t version;
    uint32_t type;
    while (rn_box_take(&file, &type, &meta)) {
        if (type != RN_BOX('m', 'e', 't', 'a') || !rn_span_take(&meta, 4, &version)) continue;
        while (!verdict && rn_box_take(&meta, &type, &box))
            if (type == RN_BOX('i', 'r', 'e', 'f')) verdict = take_references(box, parts);
    }
    return verdict;
}

static int by_item(const void *a, const void *b) {
    uint32_t left = ((const struct part *)a)->of, right = ((const struct part *)b)->of;
    return (left > right) - (left < right);
}

// The first part of the item; NULL: it has none.
static struct part *first_of(const struct parts *parts, uint32_t item) {
    size_t low = 0, high = parts->count;
    while (low < high) {
        size_t middle = (low + high) / 2;
        if (parts->list[middle].of < item)
            low = middle + 1;
        else
            high = middle;
    }
    return low < parts->count && parts->list[low].of == item ? parts->list + low : NULL;
}

// Counts what is decoded for the item that begins with this part, which is `depth` parts deep
// itself.
static enum verdict count_parts(const struct parts *parts, struct part *first, int depth) {
    uint32_t decoded = 0;
    int below = 0;
    if (first->decoded == OPEN) return OF_ITSELF;
    if (depth + first->depth > MAX_DEPTH) return TOO_DEEP;
    if (first->decoded) return SOUND;
    first->decoded = OPEN;
    first->depth = 1;
    for (struct part *part = first; part < parts->list + parts->count && part->of == first->of;
         part++) {
        struct part *inner = first_of(parts, part->is);
        enum verdict verdict = inner ? count_parts(parts, inner, depth + 1) : SOUND;
        if (verdict) return verdict;
        if (inner && inner->depth > below) below = inner->depth;
        decoded += inner ? inner->decoded : 1;
        if (decoded > MAX_PARTS) return TOO_MANY;
    }
    first->decoded = decoded;
    first->depth = below + 1;
    return depth + first->depth > MAX_DEPTH ? TOO_DEEP : SOUND;
}

enum rn_status rn_heif_check_parts(const uint8_t *bytes, size_t size_bytes, const char *where,
                                   struct rn_error *err) {
    struct parts parts = {0};
    enum verdict verdict = take_file((struct rn_span){bytes, bytes + size_bytes}, &parts);
    if (parts.count) qsort(parts.list, parts.count, sizeof *parts.list, by_item);
    for (size_t i = 0; !verdict && i < parts.count; i++)
        if (i == 0 || parts.list[i].of != parts.list[i - 1].of)
            verdict = count_parts(&parts, parts.list + i, 0);
    free(parts.list);
    switch (verdict) {
    case SOUND:
        return RN_OK;
    case NO_MEMORY:
        return rn_error_set(err, RN_ERROR_NO_MEMORY, where, "no memory to read the HEIC or AVIF");
    case OF_ITSELF:
        return rn_error_set(err, RN_ERROR_INVALID, where,
                            "a part of the HEIC or AVIF file's picture is made of itself: the file "
                            "is damaged, copy or export it again");
    case TOO_DEEP:
        return rn_error_set(err, RN_ERROR_LIMIT, where,
                            "parts of the HEIC or AVIF file's picture lie more than %d deep within "
                            "each other: convert it to JPEG",
                            MAX_DEPTH);
    default:
        return rn_error_set(err, RN_ERROR_LIMIT, where,
                            "the HEIC or AVIF file's picture is made of more than %d parts: "
                            "convert it to JPEG",
                            MAX_PARTS);
    }
}
