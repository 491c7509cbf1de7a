// The cameras' insides as instant-ngp's and nerfstudio's transforms.json give them: members of the
// document, of a frame, or of both. Internal to common/dataset.
#ifndef RN_COMMON_DATASET_INTRINSICS_H
#define RN_COMMON_DATASET_INTRINSICS_H

#include "common/dataset/reader.h"

// Where they stand. `frame_wins`: of a member that stands in both, the frame's is meant
// (instant-ngp), else the document's (nerfstudio); a difference is told. `plain_polynomial`: k3 and
// k4 belong to a perspective lens too (nerfstudio).
struct rn_intrinsics {
    struct rn_json root, frame;
    bool frame_wins, plain_polynomial;
};

// Whether a member stands there that goes beyond camera_angle_x, w and h.
bool rn_intrinsics_given(const struct rn_json *object);
// rn_reader_warn_unknown with these members known beside the NULL-terminated `own`.
void rn_intrinsics_warn_unknown(struct rn_reader *reader, const struct rn_json *object,
                                const char *const *own);

// Fills lens, focal lengths and principal point of frame->camera, whose width and height are the
// image's already; they scale with an image of another size and the same shape, which is told once.
// RN_ERROR_INVALID names the member, also one that changes the picture and is not understood.
enum rn_status rn_intrinsics_read(struct rn_reader *reader, const struct rn_intrinsics *from,
                                  struct rn_frame *frame, struct rn_error *err) RN_MUST_CHECK;

// The whole sphere: longitude over the camera's width, latitude over its height.
void rn_intrinsics_set_sphere(struct rn_camera *camera);

#endif
