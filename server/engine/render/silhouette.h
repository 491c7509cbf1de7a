// Where on a pinhole's picture anything can be seen: the occupied bricks' boxes, projected. A point
// outside shows the background, and needs no ray.
#ifndef RN_ENGINE_RENDER_SILHOUETTE_H
#define RN_ENGINE_RENDER_SILHOUETTE_H

#include "server/engine/scene/scene.h"

#define RN_SILHOUETTE_BLOCK 4 // points a side of a mark

struct rn_silhouette {
    _Atomic uint8_t *marks; // row by row; NULL: everywhere
    int width, height;      // in blocks
};

// Of the cells that the field's march reads now, as a camera of width x height points sees them.
// Everywhere in unbounded and forward-facing spaces, through a lens, and without memory.
void rn_silhouette_init(struct rn_engine *engine, const struct rn_field *field,
                        const struct rn_camera *camera, struct rn_silhouette *ret);
void rn_silhouette_finish(struct rn_silhouette *silhouette);

static inline bool rn_silhouette_covers(const struct rn_silhouette *s, int x, int y) {
    return !s->marks || s->marks[(size_t)(y / RN_SILHOUETTE_BLOCK) * (size_t)s->width +
                                 (size_t)(x / RN_SILHOUETTE_BLOCK)];
}

// Whether anything can be seen at some point of [x0, x1) x [y0, y1).
static inline bool rn_silhouette_reaches(const struct rn_silhouette *s, int x0, int y0, int x1,
                                         int y1) {
    const int block = RN_SILHOUETTE_BLOCK;
    for (int y = y0 / block * block; y < y1; y += block)
        for (int x = x0 / block * block; x < x1; x += block)
            if (rn_silhouette_covers(s, x, y)) return true;
    return false;
}

#endif
