// The networks with oneDNN: a primitive a layer over all rows, as inner products or as matrix
// products, in fp32 or with bf16 activations, gradients and weights. Weights lie as the primitive
// wants them; ReLU is part of the primitive before it.
#include <dnnl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tests/bench/libraries.h"

enum { INNER = 1, MATMUL = 2 };
static const int inner = INNER, matmul = MATMUL;

struct layer {
    dnnl_primitive_t forward, data, gradient;
    dnnl_memory_t weights, turned;  // of `forward` and of `data`
    dnnl_memory_t columns;          // matrix products: the layer's inputs, transposed
    dnnl_memory_t gradient_weights; // inner products: of one backward, as the primitive likes
    float *sum;                     // and of all, the same form
    size_t sum_count;
};

// Activations and their gradients: [0] of the inputs, [layers] of the outputs.
struct chain {
    struct problem problem;
    bool is_matmul, failed;
    dnnl_data_type_t type;
    dnnl_engine_t engine;
    dnnl_stream_t stream;
    struct layer layers[RN_MLP_MAX_LAYERS];
    dnnl_memory_t activation[RN_MLP_MAX_LAYERS + 1], grad[RN_MLP_MAX_LAYERS + 1];
    dnnl_memory_t in, out_grad; // fp32; the same as activation[0] and grad[layers] if those are
    dnnl_primitive_t take_in, take_out_grad; // NULL: nothing to convert
    float *weight_grad;
};

const char *onednn_version(void) {
    static char text[32];
    const dnnl_version_t *v = dnnl_version();
    snprintf(text, sizeof text, "%d.%d.%d", v->major, v->minor, v->patch);
    return text;
}

// ---- pieces ---------------------------------------------------------------------------------

static void expect(struct chain *c, dnnl_status_t status) {
    c->failed |= status != dnnl_success;
}

static dnnl_memory_desc_t describe(struct chain *c, int rows, int columns, dnnl_data_type_t type,
                                   dnnl_format_tag_t tag) {
    dnnl_memory_desc_t desc;
    dnnl_dims_t dims = {rows, columns};
    memset(&desc, 0, sizeof desc);
    expect(c, dnnl_memory_desc_init_by_tag(&desc, 2, dims, type, tag));
    return desc;
}

// `at`: NULL for memory of its own.
static dnnl_memory_t place(struct chain *c, const dnnl_memory_desc_t *desc, const void *at) {
    dnnl_memory_t memory = NULL;
    expect(c, dnnl_memory_create(&memory, desc, c->engine, at ? (void *)at : DNNL_MEMORY_ALLOCATE));
    return memory;
}

static void *data_of(dnnl_memory_t memory) {
    void *data = NULL;
    dnnl_memory_get_data_handle(memory, &data);
    return data;
}

static const dnnl_memory_desc_t *desc_of(dnnl_memory_t memory) {
    const dnnl_memory_desc_t *desc = NULL;
    dnnl_memory_get_memory_desc(memory, &desc);
    return desc;
}

static void run(struct chain *c, dnnl_primitive_t primitive, int from, dnnl_memory_t source,
                int with, dnnl_memory_t other, int to, dnnl_memory_t result) {
    const dnnl_exec_arg_t args[] = {{to, result}, {from, source}, {with, other}};
    expect(c, dnnl_primitive_execute(primitive, c->stream, other ? 3 : 2, args));
    dnnl_stream_wait(c->stream);
}

static dnnl_primitive_t converter(struct chain *c, dnnl_memory_t from, dnnl_memory_t to) {
    dnnl_primitive_desc_t desc = NULL;
    dnnl_primitive_t primitive = NULL;
    expect(c, dnnl_reorder_primitive_desc_create(&desc, desc_of(from), c->engine, desc_of(to),
                                                 c->engine, NULL));
    if (!c->failed) expect(c, dnnl_primitive_create(&primitive, desc));
    dnnl_primitive_desc_destroy(desc);
    return primitive;
}

static void convert_once(struct chain *c, dnnl_memory_t from, dnnl_memory_t to) {
    dnnl_primitive_t primitive = converter(c, from, to);
    if (!c->failed) run(c, primitive, DNNL_ARG_FROM, from, 0, NULL, DNNL_ARG_TO, to);
    dnnl_primitive_destroy(primitive);
}

// A primitive of an operation; leaves its description, for the backward's or to be destroyed.
static dnnl_primitive_t build(struct chain *c, const void *operation, dnnl_post_ops_t after,
                              const_dnnl_primitive_desc_t hint, dnnl_primitive_desc_t *ret_desc) {
    dnnl_primitive_attr_t attr = NULL;
    dnnl_primitive_t primitive = NULL;
    *ret_desc = NULL;
    expect(c, dnnl_primitive_attr_create(&attr));
    if (after) expect(c, dnnl_primitive_attr_set_post_ops(attr, after));
    if (!c->failed)
        expect(c, dnnl_primitive_desc_create(ret_desc, operation, attr, c->engine, hint));
    if (!c->failed) expect(c, dnnl_primitive_create(&primitive, *ret_desc));
    dnnl_primitive_attr_destroy(attr);
    return primitive;
}

// Memory of a layer's fp32 weights, [in][out], read as `desc` describes them, in the primitive's
// form.
static dnnl_memory_t pack(struct chain *c, dnnl_primitive_desc_t primitive,
                          const dnnl_memory_desc_t *desc, const float *weights) {
    if (c->failed) return NULL;
    dnnl_memory_t from = place(c, desc, weights);
    dnnl_memory_t to =
        place(c, dnnl_primitive_desc_query_md(primitive, dnnl_query_weights_md, 0), NULL);
    convert_once(c, from, to);
    dnnl_memory_destroy(from);
    return to;
}

// ---- layers ---------------------------------------------------------------------------------

static dnnl_post_ops_t relu_after(struct chain *c, bool hidden) {
    dnnl_post_ops_t after = NULL;
    expect(c, dnnl_post_ops_create(&after));
    if (hidden) expect(c, dnnl_post_ops_append_eltwise(after, 1, dnnl_eltwise_relu, 0, 0));
    return after;
}

static void build_inner(struct chain *c, int l) {
    struct layer *layer = &c->layers[l];
    const struct rn_mlp_shape *shape = &c->problem.shape;
    int in = shape->in[l], out = shape->out[l];
    const float *weights = c->problem.weights + shape->offset[l];
    dnnl_memory_desc_t plain = describe(c, out, in, dnnl_f32, dnnl_ba);
    dnnl_memory_desc_t any = describe(c, out, in, c->type, dnnl_format_tag_any);
    dnnl_memory_desc_t any_grad = describe(c, out, in, dnnl_f32, dnnl_format_tag_any);
    const dnnl_memory_desc_t *source = desc_of(c->activation[l]);
    const dnnl_memory_desc_t *result = desc_of(c->activation[l + 1]);
    dnnl_inner_product_desc_t operation;
    dnnl_primitive_desc_t desc, other;
    dnnl_post_ops_t after = relu_after(c, l + 1 < shape->layers);
    expect(c, dnnl_inner_product_forward_desc_init(&operation, dnnl_forward_training, source, &any,
                                                   NULL, result));
    layer->forward = build(c, &operation, after, NULL, &desc);
    layer->weights = pack(c, desc, &plain, weights);
    expect(c, dnnl_inner_product_backward_data_desc_init(&operation, desc_of(c->grad[l]), &any,
                                                         desc_of(c->grad[l + 1])));
    layer->data = build(c, &operation, NULL, desc, &other);
    layer->turned = pack(c, other, &plain, weights);
    dnnl_primitive_desc_destroy(other);
    expect(c, dnnl_inner_product_backward_weights_desc_init(&operation, source, &any_grad, NULL,
                                                            desc_of(c->grad[l + 1])));
    layer->gradient = build(c, &operation, NULL, desc, &other);
    if (!c->failed) {
        const dnnl_memory_desc_t *form =
            dnnl_primitive_desc_query_md(other, dnnl_query_diff_weights_md, 0);
        layer->gradient_weights = place(c, form, NULL);
        layer->sum_count = dnnl_memory_desc_get_size(form) / sizeof(float);
        layer->sum = zeros(layer->sum_count, sizeof(float));
    }
    dnnl_primitive_desc_destroy(other);
    dnnl_primitive_desc_destroy(desc);
    dnnl_post_ops_destroy(after);
}

static void build_matmul(struct chain *c, int l) {
    struct layer *layer = &c->layers[l];
    const struct rn_mlp_shape *shape = &c->problem.shape;
    int in = shape->in[l], out = shape->out[l], rows = c->problem.rows;
    const float *weights = c->problem.weights + shape->offset[l];
    dnnl_memory_desc_t plain = describe(c, in, out, dnnl_f32, dnnl_ab);
    dnnl_memory_desc_t turned = describe(c, out, in, dnnl_f32, dnnl_ba);
    dnnl_memory_desc_t any = describe(c, in, out, c->type, dnnl_format_tag_any);
    dnnl_memory_desc_t any_turned = describe(c, out, in, c->type, dnnl_format_tag_any);
    dnnl_memory_desc_t columns = describe(c, in, rows, c->type, dnnl_ba);
    dnnl_matmul_desc_t operation;
    dnnl_primitive_desc_t desc;
    dnnl_post_ops_t after = relu_after(c, l + 1 < shape->layers);
    expect(c, dnnl_matmul_desc_init(&operation, desc_of(c->activation[l]), &any, NULL,
                                    desc_of(c->activation[l + 1])));
    layer->forward = build(c, &operation, after, NULL, &desc);
    layer->weights = pack(c, desc, &plain, weights);
    dnnl_primitive_desc_destroy(desc);
    dnnl_post_ops_destroy(after);
    expect(c, dnnl_matmul_desc_init(&operation, desc_of(c->grad[l + 1]), &any_turned, NULL,
                                    desc_of(c->grad[l])));
    layer->data = build(c, &operation, NULL, NULL, &desc);
    layer->turned = pack(c, desc, &turned, weights);
    dnnl_primitive_desc_destroy(desc);
    expect(c, dnnl_post_ops_create(&after));
    expect(c, dnnl_post_ops_append_sum(after, 1));
    expect(c, dnnl_matmul_desc_init(&operation, &columns, desc_of(c->grad[l + 1]), NULL, &plain));
    layer->gradient = build(c, &operation, after, NULL, &desc);
    layer->gradient_weights = place(c, &plain, c->weight_grad + shape->offset[l]);
    layer->columns = place(c, &columns, data_of(c->activation[l]));
    dnnl_primitive_desc_destroy(desc);
    dnnl_post_ops_destroy(after);
}

// ---- candidate ------------------------------------------------------------------------------

static void destroy(void *work) {
    struct chain *c = work;
    int layers = c->problem.shape.layers;
    for (int l = 0; l < layers; l++) {
        struct layer *layer = &c->layers[l];
        dnnl_primitive_destroy(layer->forward);
        dnnl_primitive_destroy(layer->data);
        dnnl_primitive_destroy(layer->gradient);
        dnnl_memory_destroy(layer->weights);
        dnnl_memory_destroy(layer->turned);
        dnnl_memory_destroy(layer->columns);
        dnnl_memory_destroy(layer->gradient_weights);
        free(layer->sum);
    }
    if (c->in != c->activation[0]) dnnl_memory_destroy(c->in);
    if (c->out_grad != c->grad[layers]) dnnl_memory_destroy(c->out_grad);
    for (int l = 0; l <= layers; l++) {
        dnnl_memory_destroy(c->activation[l]);
        dnnl_memory_destroy(c->grad[l]);
    }
    dnnl_primitive_destroy(c->take_in);
    dnnl_primitive_destroy(c->take_out_grad);
    dnnl_stream_destroy(c->stream);
    dnnl_engine_destroy(c->engine);
    free(c->weight_grad);
    free(c);
}

// The rows between layers, and the fp32 rows at both ends.
static void build_rows(struct chain *c) {
    const struct rn_mlp_shape *shape = &c->problem.shape;
    int last = shape->layers, rows = c->problem.rows;
    bool same = c->type == dnnl_f32;
    for (int l = 0; l <= last; l++) {
        int width = l < last ? shape->in[l] : shape->out[last - 1];
        dnnl_memory_desc_t plain = describe(c, rows, width, dnnl_f32, dnnl_ab);
        dnnl_memory_desc_t typed = describe(c, rows, width, c->type, dnnl_ab);
        if (l == 0) c->in = place(c, &plain, c->problem.in);
        if (l == last) c->out_grad = place(c, &plain, c->problem.out_grad);
        c->activation[l] = l == 0 && same ? c->in : place(c, l == last ? &plain : &typed, NULL);
        c->grad[l] = l == last && same ? c->out_grad : place(c, l == 0 ? &plain : &typed, NULL);
    }
    if (same || c->failed) return;
    c->take_in = converter(c, c->in, c->activation[0]);
    c->take_out_grad = converter(c, c->out_grad, c->grad[last]);
}

static void *create(const struct candidate *candidate, const struct problem *problem) {
    struct chain *c = zeros(1, sizeof *c);
    c->problem = *problem;
    c->is_matmul = *(const int *)candidate->which == MATMUL;
    c->type = candidate->bf16 ? dnnl_bf16 : dnnl_f32;
    c->weight_grad = zeros(problem->shape.count, sizeof(float));
    expect(c, dnnl_engine_create(&c->engine, dnnl_cpu, 0));
    expect(c, dnnl_stream_create(&c->stream, c->engine, dnnl_stream_default_flags));
    build_rows(c);
    for (int l = 0; l < problem->shape.layers && !c->failed; l++)
        if (c->is_matmul)
            build_matmul(c, l);
        else
            build_inner(c, l);
    if (!c->failed) return c;
    destroy(c);
    return NULL;
}

static void forward(void *work) {
    struct chain *c = work;
    if (c->take_in)
        run(c, c->take_in, DNNL_ARG_FROM, c->in, 0, NULL, DNNL_ARG_TO, c->activation[0]);
    for (int l = 0; l < c->problem.shape.layers; l++)
        run(c, c->layers[l].forward, DNNL_ARG_SRC, c->activation[l], DNNL_ARG_WEIGHTS,
            c->layers[l].weights, DNNL_ARG_DST, c->activation[l + 1]);
}

static void backward_inner(struct chain *c, int l) {
    struct layer *layer = &c->layers[l];
    run(c, layer->gradient, DNNL_ARG_SRC, c->activation[l], DNNL_ARG_DIFF_DST, c->grad[l + 1],
        DNNL_ARG_DIFF_WEIGHTS, layer->gradient_weights);
    add(layer->sum_count, data_of(layer->gradient_weights), layer->sum);
    run(c, layer->data, DNNL_ARG_DIFF_DST, c->grad[l + 1], DNNL_ARG_WEIGHTS, layer->turned,
        DNNL_ARG_DIFF_SRC, c->grad[l]);
}

static void backward_matmul(struct chain *c, int l) {
    struct layer *layer = &c->layers[l];
    run(c, layer->gradient, DNNL_ARG_SRC, layer->columns, DNNL_ARG_WEIGHTS, c->grad[l + 1],
        DNNL_ARG_DST, layer->gradient_weights);
    run(c, layer->data, DNNL_ARG_SRC, c->grad[l + 1], DNNL_ARG_WEIGHTS, layer->turned, DNNL_ARG_DST,
        c->grad[l]);
}

static void backward(void *work) {
    struct chain *c = work;
    const struct rn_mlp_shape *shape = &c->problem.shape;
    if (c->take_out_grad)
        run(c, c->take_out_grad, DNNL_ARG_FROM, c->out_grad, 0, NULL, DNNL_ARG_TO,
            c->grad[shape->layers]);
    for (int l = shape->layers - 1; l >= 0; l--) {
        size_t count = (size_t)c->problem.rows * (size_t)shape->in[l];
        if (c->is_matmul)
            backward_matmul(c, l);
        else
            backward_inner(c, l);
        if (l > 0 && c->type == dnnl_f32)
            mask(count, data_of(c->activation[l]), data_of(c->grad[l]));
        else if (l > 0)
            mask16(count, data_of(c->activation[l]), data_of(c->grad[l]));
    }
}

// Inner products' sums leave the primitive's form.
static void look(void *work, struct outcome *ret) {
    struct chain *c = work;
    const struct rn_mlp_shape *shape = &c->problem.shape;
    for (int l = 0; l < shape->layers && !c->is_matmul; l++) {
        struct layer *layer = &c->layers[l];
        dnnl_memory_desc_t plain = describe(c, shape->out[l], shape->in[l], dnnl_f32, dnnl_ba);
        dnnl_memory_t from = place(c, desc_of(layer->gradient_weights), layer->sum);
        dnnl_memory_t to = place(c, &plain, c->weight_grad + shape->offset[l]);
        convert_once(c, from, to);
        dnnl_memory_destroy(from);
        dnnl_memory_destroy(to);
    }
    *ret = (struct outcome){.out = data_of(c->activation[shape->layers]),
                            .in_grad = data_of(c->grad[0]),
                            .weight_grad = c->weight_grad};
}

#define WAY(NAME, WHICH, BF16)                                                                     \
    {                                                                                              \
        .name = NAME, .bf16 = BF16, .which = &WHICH, .create = create, .forward = forward,         \
        .backward = backward, .look = look, .destroy = destroy                                     \
    }
const struct candidate onednn_candidates[] = {WAY("oneDNN inner product fp32", inner, false),
                                              WAY("oneDNN matmul fp32", matmul, false),
                                              WAY("oneDNN inner product bf16", inner, true),
                                              WAY("oneDNN matmul bf16", matmul, true),
                                              {0}};
