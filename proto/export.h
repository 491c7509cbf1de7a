// What a scene can be exported as by a job: POST /v1/jobs of type `export`, its file at
// /v1/jobs/{id}/export. A file for viewing is what POST /v1/scenes takes.
#ifndef RN_PROTO_EXPORT_H
#define RN_PROTO_EXPORT_H

#include "proto/codec.h"

enum rn_export_format { RN_EXPORT_PLY, RN_EXPORT_OBJ };
extern const char *const rn_export_format_names[]; // "ply", "obj"
enum rn_export_kind { RN_EXPORT_MESH, RN_EXPORT_SCENE };
extern const char *const rn_export_kind_names[]; // "mesh", "scene"

#define RN_EXPORT_SCENE_FILE "scene.ripscene"
#define RN_EXPORT_LOSS 0.05 // dB, that a file for viewing may lose where nothing is asked for

struct rn_export_options {
    int as;         // enum rn_export_kind; absent = mesh
    int format;     // enum rn_export_format; absent = ply
    int64_t cells;  // along the longest side; absent = 256
    double level;   // opacity at which the surface lies; absent = 0.5
    double crop[6]; // low corner, then high one, dataset units; absent: the scene's ball
    // Of a file for viewing; absent both: RN_EXPORT_LOSS.
    int64_t max_bytes; // of the file
    double max_loss;   // dB
};
extern const struct rn_table rn_export_options_table;
// What the table cannot say: NULL, or what is wrong with the member at `*ret_pointer`.
const char *rn_export_check(const struct rn_export_options *options, const char **ret_pointer);

struct rn_export_result {
    char file[16]; // "mesh.ply", RN_EXPORT_SCENE_FILE
    int64_t bytes;
    int64_t vertices, triangles; // of a mesh
    // Of a file for viewing: bits of a value of its planes; dB of its pictures and of the scene's,
    // means over `views` views of the split, and by how much they differ.
    int64_t bits, views;
    double psnr, trained, loss;
    int split; // rn_split_names
};
extern const struct rn_table rn_export_result_table;

#endif
