// Backdrops: photographs that stand on one colour all around, as a renderer's or a studio's white,
// are cut out of it. Trained as they are, the colour would have to be made of matter.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/dataset/reader.h"

#define LOOKED_AT 8 // photographs, evenly among all: each is decoded for it
#define LEAST 3     // of them that must tell
#define PLAIN 2     // of 255, by which a photograph's edge differs from the colour,
#define SHARE 0.7   // in so many of its pixels: what stands on it may be cut by the edge
#define NEAR 4      // of 255: from the edge on as far as pixels are so near is the backdrop

static int distance(const uint8_t *pixel, const uint8_t colour[3]) {
    int most = 0;
    for (int c = 0; c < 3; c++)
        most = abs(pixel[c] - colour[c]) > most ? abs(pixel[c] - colour[c]) : most;
    return most;
}

// ---- whether there is one ----

// The i-th pixel along a picture's edge, i < edge_length.
static const uint8_t *edge_pixel(const struct rn_image *image, size_t i) {
    size_t w = (size_t)image->width, h = (size_t)image->height, at;
    if (i < 2 * w)
        at = i < w ? i : (h - 1) * w + i - w;
    else
        at = (i - 2 * w) / 2 * w + ((i & 1) ? w - 1 : 0);
    return image->pixels + 4 * at;
}

static size_t edge_length(const struct rn_image *image) {
    return 2 * ((size_t)image->width + (size_t)image->height);
}

// By channel, the median along the edge.
static void edge_colour(const struct rn_image *image, uint8_t ret_colour[3]) {
    size_t length = edge_length(image);
    for (int c = 0; c < 3; c++) {
        size_t counts[256] = {0}, below = 0;
        int value = 0;
        for (size_t i = 0; i < length; i++)
            counts[edge_pixel(image, i)[c]]++;
        while ((below += counts[value]) * 2 < length)
            value++;
        ret_colour[c] = (uint8_t)value;
    }
}

static bool stands_on(const struct rn_image *image, const uint8_t colour[3]) {
    size_t length = edge_length(image), plain = 0;
    for (size_t i = 0; i < length; i++)
        plain += distance(edge_pixel(image, i), colour) <= PLAIN;
    return (double)plain >= SHARE * (double)length;
}

// Photographs that neither a mask nor an alpha channel says anything of.
static bool are_whole(const struct rn_dataset *dataset) {
    for (size_t f = 0; f < dataset->frame_count; f++)
        if (dataset->frames[f].has_alpha || dataset->frames[f].mask_path) return false;
    return dataset->frame_count >= LEAST;
}

void rn_reader_settle_backdrop(struct rn_reader *reader) {
    struct rn_dataset *dataset = reader->dataset;
    uint8_t colour[3];
    size_t step = 1 + (dataset->frame_count - 1) / LOOKED_AT, seen = 0;
    bool plain = are_whole(dataset);
    for (size_t f = 0; plain && f < dataset->frame_count; f += step, seen++) {
        struct rn_image image;
        if (rn_frame_decode(&dataset->frames[f], NULL, &image, NULL)) return; // told later
        if (f == 0) edge_colour(&image, colour);
        plain = stands_on(&image, colour);
        rn_image_finish(&image);
    }
    if (!plain || seen < LEAST || rn_dataset_has_bars(dataset)) return;
    bool keep = reader->options && reader->options->keep_backdrop;
    for (size_t f = 0; f < dataset->frame_count && !keep; f++) {
        struct rn_frame *frame = &dataset->frames[f];
        frame->has_alpha = frame->backdrop.known = frame->backdrop.to_cut = true;
        memcpy(frame->backdrop.colour, colour, sizeof colour);
    }
    rn_problems_add(reader->problems, RN_SEVERITY_INFO, reader->folder,
                    "all photographs stand on one colour, %d,%d,%d, as far as %zu of them say: %s",
                    colour[0], colour[1], colour[2], seen,
                    keep ? "it is kept, and has to be learned as matter; --backdrop cut takes it "
                           "for what is behind the scene"
                         : "it is taken for what is behind the scene, and what stands on it is cut "
                           "out; --backdrop keep trains it as a part of the scene");
}

// ---- cutting ----

struct cutting {
    struct rn_image *image;
    const uint8_t *colour;
    uint8_t *behind; // a byte a pixel: whether it is the backdrop
    size_t *spans;   // pixels from which on, to the left and right, is backdrop to be marked
    size_t count, capacity;
};

static bool is_open(const struct cutting *cut, size_t at) {
    return !cut->behind[at] && distance(cut->image->pixels + 4 * at, cut->colour) <= NEAR;
}

static bool push(struct cutting *cut, size_t at) {
    if (cut->count == cut->capacity) {
        size_t more = cut->capacity ? 2 * cut->capacity : 1024;
        size_t *grown = realloc(cut->spans, more * sizeof *grown);
        if (!grown) return false;
        cut->spans = grown;
        cut->capacity = more;
    }
    cut->spans[cut->count++] = at;
    return true;
}

// The beginnings of what is open in a row beside pixels first .. last.
static bool push_row(struct cutting *cut, size_t row, size_t first, size_t last) {
    bool open = false;
    for (size_t x = first; x <= last; x++) {
        bool now = is_open(cut, row + x);
        if (now && !open && !push(cut, row + x)) return false;
        open = now;
    }
    return true;
}

// Marks all that is open and reached from a pixel. False: memory is out.
static bool fill(struct cutting *cut, size_t from) {
    size_t w = (size_t)cut->image->width, h = (size_t)cut->image->height;
    if (!push(cut, from)) return false;
    while (cut->count) {
        size_t at = cut->spans[--cut->count], row = at / w * w, first = at - row, last = first;
        if (!is_open(cut, at)) continue;
        while (first > 0 && is_open(cut, row + first - 1))
            first--;
        while (last + 1 < w && is_open(cut, row + last + 1))
            last++;
        memset(cut->behind + row + first, 1, last - first + 1);
        if (row > 0 && !push_row(cut, row - w, first, last)) return false;
        if (row / w + 1 < h && !push_row(cut, row + w, first, last)) return false;
    }
    return true;
}

static bool fill_from_edges(struct cutting *cut) {
    const uint8_t *pixels = cut->image->pixels;
    for (size_t i = 0, length = edge_length(cut->image); i < length; i++)
        if (!fill(cut, (size_t)(edge_pixel(cut->image, i) - pixels) / 4)) return false;
    return true;
}

// Whether any of the 3 x 3 pixels about one, itself too, is the backdrop.
static bool touches(const struct cutting *cut, int x, int y) {
    int w = cut->image->width, h = cut->image->height;
    for (int v = y > 0 ? y - 1 : y; v <= y + 1 && v < h; v++)
        for (int u = x > 0 ? x - 1 : x; u <= x + 1 && u < w; u++)
            if (cut->behind[(size_t)v * (size_t)w + (size_t)u]) return true;
    return false;
}

// The mean colour of those about a pixel that are away from the backdrop; false: there is none.
static bool colour_beside(const struct cutting *cut, int x, int y, double ret_mean[3]) {
    int w = cut->image->width, h = cut->image->height, count = 0;
    double sum[3] = {0};
    for (int v = y > 0 ? y - 1 : y; v <= y + 1 && v < h; v++)
        for (int u = x > 0 ? x - 1 : x; u <= x + 1 && u < w; u++) {
            if (touches(cut, u, v)) continue;
            for (int c = 0; c < 3; c++)
                sum[c] += cut->image->pixels[4 * ((size_t)v * (size_t)w + (size_t)u) + (size_t)c];
            count++;
        }
    for (int c = 0; c < 3; c++)
        ret_mean[c] = sum[c] / count;
    return count > 0;
}

// How much of a pixel the colour beside it covers, least squares, but not so little that what
// covers the rest with the backdrop would be darker than black or brighter than white.
static double share_of(const uint8_t pixel[3], const uint8_t backdrop[3], const double beside[3]) {
    double dot = 0, square = 0, least = 0;
    for (int c = 0; c < 3; c++) {
        double off = pixel[c] - backdrop[c], reach = beside[c] - backdrop[c];
        double room = off < 0 ? backdrop[c] : 255 - backdrop[c];
        dot += off * reach;
        square += reach * reach;
        if (off != 0) least = fmax(least, fabs(off) / room);
    }
    return fmin(1, fmax(least, square > 0 ? dot / square : 1));
}

// A pixel at the outline is mixed of the backdrop and of what it stands beside. Over the backdrop
// it shows what it did, to the rounding.
static void unmix(const struct cutting *cut, int x, int y) {
    uint8_t *pixel = cut->image->pixels + 4 * ((size_t)y * (size_t)cut->image->width + (size_t)x);
    double beside[3];
    if (!colour_beside(cut, x, y, beside)) return; // thin: all of it is kept
    double alpha = ceil(255 * share_of(pixel, cut->colour, beside) - 1e-9) / 255;
    for (int c = 0; c < 3 && alpha > 0; c++) {
        double colour = (pixel[c] - (1 - alpha) * cut->colour[c]) / alpha;
        pixel[c] = (uint8_t)lrint(fmin(255, fmax(0, colour)));
    }
    pixel[3] = (uint8_t)lrint(255 * alpha);
}

static void clear(const struct cutting *cut) {
    struct rn_image *image = cut->image;
    for (int y = 0; y < image->height; y++)
        for (int x = 0; x < image->width; x++) {
            size_t at = (size_t)y * (size_t)image->width + (size_t)x;
            if (cut->behind[at]) {
                memcpy(image->pixels + 4 * at, cut->colour, 3);
                image->pixels[4 * at + 3] = 0;
            } else if (touches(cut, x, y)) {
                unmix(cut, x, y);
            }
        }
    image->has_alpha = true;
}

enum rn_status rn_backdrop_cut(const uint8_t colour[3], struct rn_image *image,
                               struct rn_error *err) {
    struct cutting cut = {.image = image, .colour = colour};
    cut.behind = calloc((size_t)image->width, (size_t)image->height);
    bool done = cut.behind && fill_from_edges(&cut);
    if (done) clear(&cut);
    free(cut.behind);
    free(cut.spans);
    return done ? RN_OK : rn_error_set(err, RN_ERROR_NO_MEMORY, "backdrop", "out of memory");
}
