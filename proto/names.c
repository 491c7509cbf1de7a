#include "proto/names.h"

#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

const char *const rn_job_type_names[] = {"train",  "path",     "eval",     "ingest",
                                         "curve",  "estimate", "effects",  "export",
                                         "ladder", "doctor",   "validate", NULL};
const char *const rn_job_state_names[] = {"queued",     "running",     "paused",
                                          "cancelling", "succeeded",   "failed",
                                          "cancelled",  "interrupted", NULL};
const char *const rn_scene_state_names[] = {"new", "training", "paused", "ready", "failed", NULL};
const char *const rn_finished_by_names[] = {"time", "steps", "psnr", "finish", "plateau", NULL};
const char *const rn_lens_choice_names[] = {"pinhole", "as-taken", NULL};
const char *const rn_colours_choice_names[] = {"even", "as-taken", NULL};
const char *const rn_output_kind_names[] = {"rgb",  "depth", "alpha",     "normal",
                                            "cost", "level", "footprint", NULL};
const char *const rn_output_kind_units[] = {[RN_OUTPUT_KIND_COST] = "samples",
                                            [RN_OUTPUT_KIND_LEVEL] = "levels",
                                            [RN_OUTPUT_KIND_FOOTPRINT] = "dataset units"};
const char *const rn_picture_format_names[] = {"png", "jpeg", "png16", "exr", NULL};
const char *const rn_picture_format_extensions[] = {"png", "jpg", "png", "exr", NULL};
const char *const rn_picture_format_types[] = {"image/png", "image/jpeg", "image/png",
                                               "image/x-exr", NULL};

int rn_frame_index(const char *name) {
    bool named = strspn(name, "0123456789") == 5 && name[5] == '.' &&
                 rn_name_index(rn_picture_format_extensions, name + 6) >= 0;
    return named ? atoi(name) : -1;
}

const char *const rn_scope_names[] = {"read", "render", "train", "admin", NULL};
