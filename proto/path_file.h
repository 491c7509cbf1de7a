// POST /v1/camera-paths/convert: other programs' camera paths, in both directions.
#ifndef RN_PROTO_PATH_FILE_H
#define RN_PROTO_PATH_FILE_H

#include "proto/codec.h"

#define RN_PATH_FILE_MAX (8u << 20) // bytes of each file

struct rn_path_file_request {
    // A file's text to be read, and of what lies beside it where its format has that; `from` says
    // which format, "" what its signs say.
    char *file, *beside; // owned; NULL = absent
    char from[32];
    // Or a path to be written as `to`.
    struct rn_path_document path;
    char to[32];
    // Where the file's coordinates lie: "dataset", or the text of a dataparser_transforms.json; and
    // the text of the dataset's transforms.json, which may have moved it before.
    char *space, *dataset;
};
extern const struct rn_table rn_path_file_request_table;

struct rn_path_file {
    char format[32];              // that was read or written
    struct rn_path_document path; // read
    char *file, *beside;          // written
    char beside_name[32];         // "cameras.txt"
};
extern const struct rn_table rn_path_file_table;

#endif
