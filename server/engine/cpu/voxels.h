// Reading the voxel grid beside the planes, and adding gradients to it (field/voxels.h). Features
// of a constant grid are the constant, others within 2 ULP of the side times the largest voxel;
// adding is reading's adjoint within 16 ULP of sum |x y|.
#ifndef RN_ENGINE_CPU_VOXELS_H
#define RN_ENGINE_CPU_VOXELS_H

#include "server/engine/cpu/fetch.h"
#include "server/engine/field/voxels.h"

// The voxel grid as it is read: the first number, voxels a side.
struct voxels {
    float *first;
    int side;
    size_t row, slice; // numbers
};

RN_INLINE struct voxels voxels_of(const struct rn_field_config *config, const struct rn_map *map) {
    struct voxels v = {.first = map->texels, .side = rn_voxel_side(config)};
    v.row = (size_t)v.side * RN_VOXEL_CHANNELS;
    v.slice = v.row * (size_t)v.side;
    return v;
}

// Where a few vectors of samples look: the first of a sample's eight voxels, and the weights of
// the next along x, y and z.
struct voxel_lookup {
    int32_t voxel[RN_AHEAD];
    float x[RN_AHEAD], y[RN_AHEAD], z[RN_AHEAD];
};

RN_INLINE void look_up_voxels(int side, float *const place[3], int at, int n,
                              struct voxel_lookup *ret) {
    for (int i = 0; i < n; i += RN_VL) {
        vi x, y, z;
        vf fx, fy, fz;
        lerp_vector(vf_load(place[0] + at + i), side, &x, &fx);
        lerp_vector(vf_load(place[1] + at + i), side, &y, &fy);
        lerp_vector(vf_load(place[2] + at + i), side, &z, &fz);
        vi_store(ret->voxel + i, (z * side + y) * side + x);
        vf_store(ret->x + i, fx);
        vf_store(ret->y + i, fy);
        vf_store(ret->z + i, fz);
    }
}

// Two neighbours along x lie together.
RN_INLINE void voxels_ahead(const struct voxels *v, int32_t voxel) {
    const float *first = v->first + (size_t)voxel * RN_VOXEL_CHANNELS;
    __builtin_prefetch(first);
    __builtin_prefetch(first + v->row);
    __builtin_prefetch(first + v->slice);
    __builtin_prefetch(first + v->slice + v->row);
}

RN_INLINE v4 fetch_row(const float *first, size_t below, float fy, float fx) {
    v4 left = *(const v4 *)first, right = *(const v4 *)(first + RN_VOXEL_CHANNELS);
    left += fy * (*(const v4 *)(first + below) - left);
    right += fy * (*(const v4 *)(first + below + RN_VOXEL_CHANNELS) - right);
    return left + fx * (right - left);
}

// Features of samples [begin, end), at `place`, to rows `out`, `stride` apart.
RN_INLINE void encode_voxels(const struct voxels *v, float *const place[3], int begin, int end,
                             feature *out, size_t stride) {
    struct voxel_lookup at;
    for (int i = begin; i < end; i += RN_AHEAD) {
        int n = end - i < RN_AHEAD ? end - i : RN_AHEAD;
        look_up_voxels(v->side, place, i, n, &at);
        for (int j = 0; j < n; j++)
            voxels_ahead(v, at.voxel[j]);
        for (int j = 0; j < n; j++) {
            const float *first = v->first + (size_t)at.voxel[j] * RN_VOXEL_CHANNELS;
            v4 near = fetch_row(first, v->row, at.y[j], at.x[j]);
            v4 far = fetch_row(first + v->slice, v->row, at.y[j], at.x[j]);
            store_features_4(out + (size_t)(i + j) * stride, near + at.z[j] * (far - near));
        }
    }
}

// A band of the grid, whole rows of the plane whose room it has: of voxels, and of the tiles that
// the optimiser visits (rn_tiling).
struct voxel_band {
    int32_t begin, end;
    int32_t a_row, a_tile; // voxels
    int columns;           // tiles a row
};

RN_INLINE struct voxel_band band_of_voxels(const struct rn_field_config *config, int row_begin,
                                           int row_end) {
    struct rn_tiling tiling = rn_tiling(config->base, config->channels, 1);
    int32_t a_row = config->base * config->channels / RN_VOXEL_CHANNELS;
    return (struct voxel_band){.begin = row_begin * a_row,
                               .end = row_end * a_row,
                               .a_row = a_row,
                               .a_tile = config->channels << tiling.shift_x >> 2,
                               .columns = tiling.columns};
}

RN_INLINE void add_to_voxel(const struct voxels *v, const struct voxel_band *band, int32_t voxel,
                            v4 grad, uint8_t *touched) {
    if (voxel < band->begin || voxel >= band->end) return;
    int32_t row = voxel / band->a_row;
    touched[row * band->columns + (voxel - row * band->a_row) / band->a_tile] = 1;
    *(v4 *)(v->first + (size_t)voxel * RN_VOXEL_CHANNELS) += grad;
}

RN_INLINE void scatter_voxels(const struct voxels *v, const struct rn_slab *slab,
                              const struct voxel_band *band, uint8_t *touched) {
    struct voxel_lookup at;
    int32_t slice = v->side * v->side, reach = slice + v->side + 1; // of a sample's last voxel
    for (int i = 0; i < slab->count; i += RN_AHEAD) {
        int n = slab->count - i < RN_AHEAD ? slab->count - i : RN_AHEAD, found = 0;
        uint8_t sample[RN_AHEAD];
        look_up_voxels(v->side, slab->voxel, i, n, &at);
        for (int j = 0; j < n; j++) {
            if (at.voxel[j] >= band->end || at.voxel[j] + reach < band->begin) continue;
            sample[found++] = (uint8_t)j;
            voxels_ahead(v, at.voxel[j]);
        }
        for (int k = 0; k < found; k++) {
            int j = sample[k];
            v4 grad = *(const v4 *)(slab->voxel_grad + (size_t)(i + j) * RN_VOXEL_CHANNELS);
            for (int corner = 0; corner < 4; corner++) {
                float y = corner & 1 ? at.y[j] : 1 - at.y[j];
                float z = corner & 2 ? at.z[j] : 1 - at.z[j];
                int32_t voxel = at.voxel[j] + (corner & 1 ? v->side : 0) + (corner & 2 ? slice : 0);
                v4 share = grad * (y * z), next = share * at.x[j];
                add_to_voxel(v, band, voxel, share - next, touched);
                add_to_voxel(v, band, voxel + 1, next, touched);
            }
        }
    }
}

RN_INLINE v4 voxel_at(const float *voxel) {
    return *(const v4 *)voxel;
}

static void smooth_voxels(float *first, int side, int z, bool odd, float share) {
    size_t row = (size_t)side * RN_VOXEL_CHANNELS, slice = row * (size_t)side;
    size_t nearer = z > 0 ? slice : 0, farther = z + 1 < side ? slice : 0;
    for (int y = 0; y < side; y++) {
        size_t above = y > 0 ? row : 0, below = y + 1 < side ? row : 0;
        float *voxel = first + (size_t)z * slice + (size_t)y * row;
        for (int x = (y + z + odd) % 2; x < side; x += 2) {
            float *at = voxel + (size_t)x * RN_VOXEL_CHANNELS;
            v4 around = voxel_at(x > 0 ? at - RN_VOXEL_CHANNELS : at) +
                        voxel_at(x + 1 < side ? at + RN_VOXEL_CHANNELS : at);
            around += voxel_at(at - above) + voxel_at(at + below);
            around += voxel_at(at - nearer) + voxel_at(at + farther);
            *(v4 *)at += share * (around - 6 * voxel_at(at));
        }
    }
}

#endif
