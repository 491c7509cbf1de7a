// Records that the folder of a scene or a job keeps as files of JSON.
#ifndef RN_PROTO_FOLDER_H
#define RN_PROTO_FOLDER_H

#include "proto/codec.h"

// Reads FOLDER/NAME. RN_ERROR_NOT_FOUND, RN_ERROR_LIMIT (over 1 MiB, or a path that is too long),
// or as rn_decode. The message is the caller's to finish.
enum rn_status rn_folder_read(const char *folder, const char *name, const struct rn_table *table,
                              void *ret_message, struct rn_error *err) RN_MUST_CHECK;
// Writes it, whole or not at all.
enum rn_status rn_folder_write(const char *folder, const char *name, const char *json,
                               struct rn_error *err) RN_MUST_CHECK;

#endif
