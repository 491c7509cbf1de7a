// Memory for jansson, which goes wrong without: while a text grows it does not notice that memory
// has ended, and writes past the part that it has (2.14, lex_save).
#ifndef RN_COMMON_DATASET_JSON_MEMORY_H
#define RN_COMMON_DATASET_JSON_MEMORY_H

#include <jansson.h>

// json_loadb, for which a reserve goes on where memory ends; where that ends too, the process.
// Duplicate members are refused. Thread-safety: any thread.
json_t *rn_json_load(const char *json, size_t size, json_error_t *error);

#endif
