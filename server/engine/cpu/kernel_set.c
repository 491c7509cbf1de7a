// One kernel set: this file is compiled once for each, with RN_KERNEL_SET naming it.
#include "server/engine/cpu/backward.h"
#include "server/engine/kernels/kernels.h"
#include "server/engine/cpu/pyramid.h"
#include "server/engine/cpu/rays.h"
#include "server/engine/cpu/render.h"
#include "server/engine/cpu/scatter.h"
#include "server/engine/cpu/smooth.h"
#include "server/engine/cpu/stage.h"
#include "server/engine/cpu/update.h"

static void density(const struct rn_cpu_field *field, float (*points)[3], int count, float level,
                    struct rn_workspace *w, float *ret_density) {
    int levels =
        field->built_levels < field->config->levels ? field->built_levels : field->config->levels;
    bool leveled = level > 0 && levels > 1 && field->config->footprint != RN_FOOTPRINT_POINT;
    struct mlp base = base_network(field, w);
    if (level > (float)(levels - 1)) level = (float)(levels - 1);
    for (int begin = 0; begin < count; begin += w->full) {
        int n = count - begin < w->full ? count - begin : w->full;
        for (int i = 0; i < n; i++) {
            const float *x = points[begin + i];
            for (int p = 0; p < field->config->planes; p++) {
                const double *au = field->solid.axis_u[p], *av = field->solid.axis_v[p];
                w->u[p][i] = (float)au[0] * x[0] + (float)au[1] * x[1] + (float)au[2] * x[2];
                w->v[p][i] = (float)av[0] * x[0] + (float)av[1] * x[1] + (float)av[2] * x[2];
                w->lx[p][i] = w->ly[p][i] = level;
            }
            for (int k = 0; field->config->voxels && k < 3; k++)
                w->voxel[k][i] = x[k];
            float inside = x[0] * x[0] + x[1] * x[1] + x[2] * x[2];
            bool everywhere = field->disparity.on; // the box is the hull
            w->interval[i] = inside <= 1 || everywhere ? 1 : 0;
        }
        encode(field, leveled, 0, n, w);
        mlp_forward(&base, 0, n);
        activate(field, 0, n, w);
        memcpy(ret_density + begin, w->x, (size_t)n * sizeof(float));
    }
}

#define RN_MAP_FUNCTION(NAME, CALL)                                                                \
    static void NAME(size_t n, const float *x, float *y) {                                         \
        for (size_t i = 0; i < n; i += RN_VL)                                                      \
            vf_store(y + i, CALL(vf_load(x + i)));                                                 \
    }
RN_MAP_FUNCTION(exp_public, vf_exp)
RN_MAP_FUNCTION(one_minus_exp_public, vf_one_minus_exp)
RN_MAP_FUNCTION(log2_public, vf_log2)

static void moments_public(size_t n, const float *t, float width, float radius, float *shift,
                           float *axial, float *radial) {
    for (size_t i = 0; i < n; i += RN_VL) {
        vf s, a, r, at = vf_load(t + i);
        frustum_lanes(at, frustum_ratio(at, 0.5f * width), 0.5f * width, radius, &s, &a, &r);
        vf_store(shift + i, s);
        vf_store(axial + i, a);
        vf_store(radial + i, r);
    }
}

#define RN_PASTE2(a, b) a##b
#define RN_PASTE(a, b) RN_PASTE2(a, b)
#define RN_STRING2(a) #a
#define RN_STRING(a) RN_STRING2(a)

static const struct rn_kernel_parts parts = {
    .gemm = gemm_public,
    .exp = exp_public,
    .one_minus_exp = one_minus_exp_public,
    .log2 = log2_public,
    .moments = moments_public,
    .stage = stage,
    .put_features = put_features,
    .get_features = get_features,
};

extern const struct rn_kernels RN_PASTE(rn_kernels_, RN_KERNEL_SET);
const struct rn_kernels RN_PASTE(rn_kernels_, RN_KERNEL_SET) = {
    .name = RN_STRING(RN_KERNEL_SET),
    .unit = PRODUCT_UNIT,
    .rays = rays,
    .train = train,
    .render = render,
    .density = density,
    .pack = mlp_pack,
    .scatter = scatter,
    .update = update,
    .build = build_plane,
    .pull_down = pull_down_plane,
    .smooth = smooth,
    .smooth_voxels = smooth_voxels,
    .adamw = adamw,
    .parts = &parts,
};
