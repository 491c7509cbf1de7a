#include "server/engine/render/silhouette.h"

#include <math.h>
#include <stdatomic.h>
#include <stdlib.h>

#define ROUNDING 0.01 // of a point, about

struct drawing {
    const struct rn_silhouette *to;
    const struct rn_occupancy_bits *bits;
    struct rn_view view;
    double half[3]; // a brick's extents along the camera's axes
};

// Blocks between two coordinates of the picture, `count` of them in all; false: there are none.
static bool find_blocks(double low, double high, int count, int *ret_first, int *ret_last) {
    low = floor((low - ROUNDING) / RN_SILHOUETTE_BLOCK);
    high = floor((high + ROUNDING) / RN_SILHOUETTE_BLOCK);
    *ret_first = (int)fmax(low, 0);
    *ret_last = (int)fmin(high, count - 1);
    return low < count && high >= 0;
}

// The box around the brick along the camera's axes, as far as it may reach on the picture.
static void draw_brick(const struct drawing *d, const double at[3]) {
    const struct rn_view *view = &d->view;
    const double focal[2] = {1 / view->inverse_fx, 1 / view->inverse_fy};
    const double centre[2] = {view->cx, view->cy};
    const int blocks[2] = {d->to->width, d->to->height};
    double seen[3] = {0};
    int first[2], last[2];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            seen[j] += view->axes[i][j] * (at[i] - view->origin[i]);
    double near = seen[2] - d->half[2], far = seen[2] + d->half[2];
    if (far <= 0) return;
    for (int j = 0; j < 2; j++) {
        double low = seen[j] - d->half[j], high = seen[j] + d->half[j];
        low = near > 0 ? centre[j] + focal[j] * low / (low < 0 ? near : far) : -INFINITY;
        high = near > 0 ? centre[j] + focal[j] * high / (high > 0 ? near : far) : INFINITY;
        if (!find_blocks(low, high, blocks[j], &first[j], &last[j])) return;
    }
    for (int y = first[1]; y <= last[1]; y++)
        for (int x = first[0]; x <= last[0]; x++)
            atomic_store_explicit(&d->to->marks[(size_t)y * (size_t)d->to->width + (size_t)x], 1,
                                  memory_order_relaxed);
}

// A layer of bricks.
static void draw_layer(void *context, int index, int thread) {
    const struct drawing *d = context;
    int side = d->bits->cells / RN_BRICK;
    const uint8_t *distance = d->bits->distance + (size_t)index * (size_t)side * (size_t)side;
    (void)thread;
    for (int y = 0; y < side; y++)
        for (int z = 0; z < side; z++) {
            const double at[3] = {(2.0 * index + 1) / side - 1, (2.0 * y + 1) / side - 1,
                                  (2.0 * z + 1) / side - 1};
            if (distance[(size_t)y * (size_t)side + (size_t)z] == 0) draw_brick(d, at);
        }
}

void rn_silhouette_init(struct rn_engine *engine, const struct rn_field *field,
                        const struct rn_camera *camera, struct rn_silhouette *ret) {
    const int block = RN_SILHOUETTE_BLOCK;
    *ret = (struct rn_silhouette){.width = (camera->width + block - 1) / block,
                                  .height = (camera->height + block - 1) / block};
    if (rn_is_place(&field->cpu) || camera->lens) return;
    ret->marks = calloc((size_t)ret->width, (size_t)ret->height);
    if (!ret->marks) return;
    struct drawing d = {ret, &field->cpu.occupancy, rn_field_view(field, camera), {0}};
    int side = d.bits->cells / RN_BRICK;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            d.half[j] += fabs(d.view.axes[i][j]) / side;
    rn_pool_run(engine->pool, side, draw_layer, &d);
}

void rn_silhouette_finish(struct rn_silhouette *silhouette) {
    free(silhouette->marks);
    silhouette->marks = NULL;
}
